"""``python -m morphofold``."""

import sys

from morphofold.cli import main

sys.exit(main())
