"""`python -m objgraph.cli`."""

import sys

from objgraph.cli.main import main

sys.exit(main())
