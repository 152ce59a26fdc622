"""`python -m zebrat_bullet` is `zebrat`."""

import sys

from zebrat_bullet.cli import main

if __name__ == "__main__":  # a worker process imports it again
    sys.exit(main())
