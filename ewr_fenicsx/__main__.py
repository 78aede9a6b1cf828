"""``python -m ewr_fenicsx`` is ``ewr``."""

import sys

from ewr_fenicsx.cli import main

sys.exit(main())
