"""`python -m mexpress`: the command line."""

import sys

from mexpress.cli import main

sys.exit(main())
