"""Operator's terminal: without an action a live display with keys to steer, and e-stop source.

With an action it joins the graph, which takes seconds, and makes a single request:

ready     torque on, legs hold their angles     stand     follow commands slowly
walk      follow commands                       relax     ramp to slack, then torque off
estop     torque off at once                    reset     return from ESTOP or FAULT to IDLE
state     print state, reason and warnings      reboot    restart a servo, torque off
zero      set a leg's relaxed angle to its present one, torque off
forget    take a silent source of the e-stop for gone, by its name
inject    inject a fault into the simulated robot
"""

import argparse
import signal
import sys
from collections.abc import Sequence

from slot_core.command_line import command_parser, refuse
from slot_core.config import ConfigError
from slot_core.names import LEGS
from slot_core.refusal import InputError

# to the supervisor
REQUESTS = ("ready", "stand", "walk", "relax", "estop", "reset")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/operate`; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    from slot_bringup.check import check_place  # noqa: PLC0415 - heavy
    from slot_bringup.operate import act  # noqa: PLC0415

    try:
        check_place(options.namespace)
    except ConfigError as error:
        parser.error(str(error))
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        return act(options, parser.prog)
    except InputError as error:
        refuse(parser.prog, error)
        return 1
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("operate", __doc__)
    parser.add_argument(
        "--namespace",
        metavar="NAME",
        default="",
        help="of the graph, as given to scripts/run",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    for name in (*REQUESTS, "state"):
        actions.add_parser(name)
    for name in ("reboot", "zero"):
        actions.add_parser(name).add_argument("leg", choices=LEGS)
    actions.add_parser("forget").add_argument(
        "source", help="name, as the refusal of a reset has it"
    )
    inject = actions.add_parser("inject")
    inject.add_argument("kind", help="kind of fault, as in config/scene")
    inject.add_argument("leg", choices=(*LEGS, "all"), nargs="?", default="all")
    inject.add_argument(
        "--value", type=float, default=0.0, help="in the unit of the kind"
    )
    inject.add_argument(
        "--duration",
        type=float,
        default=0.0,
        help="s; 0 (default): until cleared",
    )
    inject.add_argument(
        "--clear", action="store_true", help="clear this kind at this leg"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
