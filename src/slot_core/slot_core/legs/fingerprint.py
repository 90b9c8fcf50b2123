"""Fingerprint of a leg: the robot's parameters that a leg map or a gait was made for.

Leg map and gait carry it as `made_for`, values by dotted name, as of a robot.yaml. Below TOLERANCE
the legs are those of another print, which the robot walks with.
"""

from typing import Any

import numpy as np

from slot_core import config
from slot_core.robot import RobotParameters

# Parameters of the statics of a leg, and the share by which they may differ. EI goes with the cube
# of the thickness; the walk takes E within 20 % and tendons .35 mm off.
LEG = {
    "leg.reach": 0.05,
    "leg.natural_shape": 0.05,
    "leg.width": 0.1,
    "leg.contact_width": 0.1,
    "leg.thickness_clamp": 0.05,
    "leg.thickness_tip": 0.05,
    "leg.density": 0.5,
    "leg.young_modulus": 0.2,
    "leg.poisson_ratio": 0.1,
    "tendon.end_fraction": 0.05,
    "tendon.offset": 0.05,
    "tendon.cable_stiffness": 0.5,
    "tendon.slack": 0.15,
    "tendon.spool_radius": 0.05,
    "tendon.angle_max_deg": 0.05,
}
TOLERANCE = LEG | {
    "leg.azimuth_deg": 0.1,
    "torso.mass": 0.2,
    "torso.size": 0.2,
}
MEND = "scripts/tune leg makes it anew"


def fingerprint(
    robot: RobotParameters, names: Any = TOLERANCE
) -> dict[str, Any]:
    """Values of a robot's parameters by dotted name: those of a gait, or with LEG of a leg map."""
    values = {name: value for name, value, _ in config.leaves(robot)}
    return {name: values[name] for name in names}


def misfit(made_for: Any, robot: RobotParameters, where: str) -> str:
    """One line on the first parameter in which a robot differs from a fingerprint, or "".

    where: the file. Raises ConfigError for what is no fingerprint.
    """
    if made_for is None:
        return f"{where} does not say for which leg it was made; {MEND}"
    made = config.replace(robot, made_for, f"{where}: made_for")
    for (name, before, meta), (_, now, _) in zip(
        config.leaves(made), config.leaves(robot)
    ):
        if before != now and not np.allclose(
            now, before, rtol=TOLERANCE.get(name, 0.0), atol=0.0
        ):
            return (
                f"{where} was made for {name} = {_text(before, meta['unit'])},"
                f" robot.yaml says {_text(now, meta['unit'])}; {MEND}"
            )
    return ""


def is_of(made_for: Any, robot: RobotParameters) -> bool:
    """Whether a fingerprint is the robot's to the last digit; raises ConfigError."""
    return (
        made_for is not None
        and config.replace(robot, made_for, "made_for") == robot
    )


def _text(value: Any, unit: str) -> str:
    numbers = (f"{number:g}" for number in np.atleast_1d(value))
    return f"{' '.join(numbers)} {unit}".strip()
