"""The command line as `python -m jaxshroud`."""

import sys

from jaxshroud_command import main

sys.exit(main())
