"""Makes one page in Markdown of the paper's figures and claims, beside what was measured here.

Ours are read from the results of scripts/bench and scripts/validate. The page names the revision and
machine of each, and the command of each that is missing. All figures of the benchmarks are made into
a page by scripts/docs --figures.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import CommandParser


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/report`; ends with exit code 2 and one line on a bad input."""
    parser = CommandParser(prog="scripts/report", description=__doc__)
    for name, kind, default in (
        ("--results", "DIR", "results"),
        ("--out", "FILE", "results/report.md"),
    ):
        parser.add_argument(
            name,
            type=Path,
            metavar=kind,
            default=default,
            help=f"default: {default}",
        )
    options = parser.parse_args(arguments)
    from documentation.paper_page import page  # noqa: PLC0415 - heavy
    from documentation.results import write_page  # noqa: PLC0415 - heavy

    return write_page(
        parser, options, lambda: page(options.results, options.out)
    )


if __name__ == "__main__":
    sys.exit(main())
