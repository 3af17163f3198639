"""The entry point. It imports nothing of the rest before a Ctrl-C is answered in words: that takes half a second."""

import sys

from scuhand_bt.exit_codes import ExitCode


def main() -> None:
    """The command line; the exit code says how it went."""
    try:
        from scuhand_bt import cli

        cli.main()
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        sys.exit(ExitCode.INTERRUPTED)


if __name__ == "__main__":
    main()
