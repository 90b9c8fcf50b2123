"""The gaits as printed, section V-A: the front legs take turns, the rear legs stay wound.

In the MPC's schedule each front leg is pulled for half a period, FL first, and the other one is
released; no leg is lifted. P gives a period of 5 s. A robot that is to stand pulls none.

The gaits of the experiments, section VI-C and VI-D, are `config/gait/paper_walk.yaml` and
`paper_crawl.yaml`, each with its source; `config/scene/published.yaml` has the walk's friction by
phase. They run as every gait does: `scripts/run --gait paper_walk --scene published`.
"""

import numpy as np

from slot_core.gait.gait import GaitPreview

FRONT = (0, 1)  # FL, FR
PERIOD = 5.0  # s
LEAST_VELOCITY = 1e-4  # m/s, rad/s: below it the robot stands


def pulled_leg(preview: GaitPreview) -> int | None:
    """The front leg that is pulled at the present phase; None where the robot is to stand."""
    if not np.abs(preview.velocity_ahead[0]).max() > LEAST_VELOCITY:
        return None
    return FRONT[int(preview.phase >= 0.5)]


def pulled_leg_at(time: float) -> int:
    """The front leg that is pulled at a time (s) of a walk in the printed period."""
    return FRONT[int(time % PERIOD >= PERIOD / 2)]
