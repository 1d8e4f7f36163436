"""jaxshroud: rub-impact dynamics of two shrouded turbine blades, event-exact, batched and differentiable."""

import lazy_loader

from jaxshroud.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
