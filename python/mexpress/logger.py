"""What long work tells those who listen: ``logging.getLogger("mexpress")``, which prints nothing by default."""

import logging

LOG = logging.getLogger("mexpress")
LOG.addHandler(logging.NullHandler())
