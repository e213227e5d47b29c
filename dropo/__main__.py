"""`python -m dropo`: the same as the command `dropo`."""

import sys

from dropo.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
