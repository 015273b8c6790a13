"""``python -m contactimg``."""

import sys

from contactimg.cli import main

sys.exit(main())
