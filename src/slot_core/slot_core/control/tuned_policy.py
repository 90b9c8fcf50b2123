"""Tuned policy: a policy whose settings can be changed while the robot stands."""

from collections.abc import Callable, Mapping
from typing import Any

from slot_core import config
from slot_core.config import ConfigError
from slot_core.control.policy import Policy, Status, TendonPlan
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import STAND, GaitPreview
from slot_core.key_frame import StateParts

PLANNED = (Status.SOLVED, Status.LATE)  # a first plan may be late


class TunedPolicy:
    """Runs a policy; with other settings it is made anew and learns the disturbances again."""

    STATE = StateParts("_policy")

    def __init__(self, make: Callable[[Any], Policy], settings: Any):
        """make: makes the policy with its settings; raises ConfigError as it does."""
        self._make, self._settings = make, settings
        self.changes: dict[str, Any] = {}  # of the settings, by dotted name
        self._policy = make(settings)
        self._last: tuple[Estimate, GaitPreview] | None = None

    def step(self, estimate: Estimate, preview: GaitPreview) -> TendonPlan:
        """The policy's plan."""
        self._last = estimate, preview
        return self._policy.step(estimate, preview)

    def prepare(self) -> None:
        """Let the policy compute ahead."""
        self._policy.prepare()

    def reset(self) -> None:
        """Let the policy begin anew."""
        self._policy.reset()

    def change(self, changes: Mapping[str, Any]) -> None:
        """Change settings, by dotted name.

        Raises ConfigError for an invalid value, while the robot does not stand, and if no plan can
        be made with the new settings.
        """
        wanted = self.changes | dict(changes)
        tried = self._made(wanted)
        if self._last is not None:
            estimate, preview = self._last
            for gait in (preview.gait, preview.command.gait):
                if gait != STAND:
                    raise ConfigError(
                        f"gait {gait}: settings change in {STAND} only, see /set_gait"
                    )
            plan = tried.step(estimate, preview)
            if plan.status not in PLANNED:
                raise ConfigError(f"{', '.join(changes)}: {plan.message}")
        self.use(wanted)

    def use(self, changes: Mapping[str, Any]) -> None:
        """Make the policy with these changes of the first settings; raises ConfigError."""
        self._policy, self.changes = self._made(changes), dict(changes)

    def _made(self, changes: Mapping[str, Any]) -> Policy:
        return self._make(
            config.replace(self._settings, changes, "settings of the policy")
        )
