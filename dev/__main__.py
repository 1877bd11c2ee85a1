"""``python3 dev``: the commands of developers."""

import sys

from commands import main
from environment import stop

if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        print(file=sys.stderr)
        stop("interrupted.", 130)
    except OSError as error:
        stop(f"{error}.")
