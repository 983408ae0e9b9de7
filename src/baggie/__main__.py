"""The `baggie` command, also as `python -m baggie` and `accelerate launch -m baggie`."""

import sys


def main() -> int:
    """Run the command line; see `baggie.cli.main`."""
    # Late, because every worker process imports this module again and reads no command line.
    from baggie.cli.main import main as run  # noqa: PLC0415

    return run()


if __name__ == "__main__":
    sys.exit(main())
