"""`python -m soundspaces_choras`."""

import sys

from soundspaces_choras import main

sys.exit(main())
