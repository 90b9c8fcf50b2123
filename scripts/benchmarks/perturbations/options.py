"""Options of the benchmark."""

import argparse

PLANTS = ("torso", "robot")


def options(parser: argparse.ArgumentParser) -> None:
    """Options of the Monte Carlo study."""
    parser.add_argument("--samples", type=int, default=0, metavar="N", help="random samples")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the samples")
    parser.add_argument("--plant", choices=PLANTS, default=PLANTS[0], help="of the samples")
    parser.add_argument(
        "--observer", type=float, metavar="S",
        help="time constant of the MPC's observer of mass and bias in the samples, 0: none"
        " (default: disturbance.time of config/mpc.yaml)",
    )  # fmt: skip
    parser.add_argument(
        "--scheduler", default="", metavar="ADDRESS", help="of a dask cluster, else local processes"
    )
