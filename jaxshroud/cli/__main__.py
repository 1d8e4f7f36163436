"""The command line as `python -m jaxshroud.cli`."""

import sys

from jaxshroud_command import main

sys.exit(main())
