"""Settings of `config/tune.yaml`."""

from dataclasses import dataclass

from slot_core import config
from slot_core.config import quantity, text
from slot_core.gait.gait import Vector3


@dataclass(frozen=True)
class TuningSettings:
    """How strides are simulated, searched and identified."""

    scene: str = text("scene of config/scene")
    friction: tuple[float, ...] = quantity(
        "friction coefficients of the floors", "", 0.01, 2
    )
    command_period: float = quantity(
        "time between commands of the tendon angles", "s", 1e-3, 0.1
    )
    settling_strides: int = quantity(
        "strides before the first that counts", "", 0, 100
    )
    strides: int = quantity("strides that count", "", 1, 1000)
    height_gain: float = quantity(
        "share of a height error that one stride corrects", "", 0, 1
    )
    evaluations: int = quantity("candidates of a search", "", 1, 1_000_000)
    population: int = quantity("candidates of a generation", "", 4, 10_000)
    step_deg: float = quantity(
        "first standard deviation of the candidates", "deg", 0.01, 90
    )
    coefficient_max_deg: float = quantity(
        "largest coefficient of a pattern", "deg", 1, 360
    )
    scatter_deg: float = quantity(
        "standard deviation of a random start", "deg", 0.01, 90
    )
    speed_scale: Vector3 = quantity(
        "speed that costs 1: v_x, v_y, yaw rate", "SI", 1e-4, 1
    )
    tilt_deg: float = quantity(
        "tilt RMS that costs nothing; largest tilt: twice", "deg", 0, 45
    )
    load: float = quantity(
        "mean torque over stall torque that costs nothing", "", 0, 1
    )
    dip: float = quantity(
        "drop below the stride's height that costs nothing", "m", 0, 0.1
    )
    steering_step_deg: float = quantity(
        "step of a steering coefficient", "deg", 0.01, 20
    )
    steering_rate: float = quantity(
        "yaw rate of the steering that is sought", "rad/s", 1e-3, 0.2
    )
    steering_scale: Vector3 = quantity(
        "size of an error of the steering: v_y, yaw rate, roll", "SI", 1e-4, 1
    )
    steering_damping: float = quantity(
        "weight of a steering coefficient per deg", "", 0, 10
    )


def read_tuning() -> TuningSettings:
    """Read `config/tune.yaml`; raises ConfigError."""
    return config.read(TuningSettings, "tune")
