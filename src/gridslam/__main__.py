"""`python -m gridslam`: the command line."""

from __future__ import annotations

import sys

from gridslam.cli.main import main

sys.exit(main())
