"""The command line as `python -m jaxshroud.cli`."""

import sys

from jaxshroud.cli.commands import main

sys.exit(main())
