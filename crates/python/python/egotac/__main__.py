"""The command `egotac`."""

import signal
import sys

from . import _egotac


def main():
    # Ctrl-C ends the command at once, as it ends the program; Python would only note it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(_egotac.run_command(["egotac", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
