"""`python -m reskpn`."""

import sys

from reskpn.cli import main

sys.exit(main())
