"""``python -m grainmesh``, the command line."""

import sys

from grainmesh.cli import main

sys.exit(main())
