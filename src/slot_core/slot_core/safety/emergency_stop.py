"""The e-stop: it is pressed until every source that has pressed it has released it.

A source is a terminal or a button, told apart by its name. It repeats its state, so that its loss
is noticed. A source that is lost while pressed stays pressed until an operator says that it is
gone. One that is lost while released counts as lost until it is back, or until a reset with
another source alive.
Times are on a clock that never goes back, ns.
"""

from dataclasses import dataclass

from slot_core.clock import to_seconds


@dataclass(frozen=True)
class _Source:
    received: int  # ns, time of its last message
    pressed: bool


class EmergencyStop:
    """Sources of the e-stop by name, with their last message."""

    def __init__(self, limit: float, required: bool) -> None:
        """`limit`: longest time between two messages of a source, s; `required`: as a setting."""
        self._limit, self._required = limit, required
        self._sources: dict[str, _Source] = {}

    def receive(
        self, time: int, source: str, pressed: bool, leaving: bool = False
    ) -> None:
        """State of a source; a source that is `leaving` is not missed, unless it is pressed."""
        if leaving and not pressed:
            self._sources.pop(source, None)
        else:
            self._sources[source] = _Source(time, pressed)

    def pressed(self, time: int) -> str:
        """The pressed sources in one line, or ""."""
        silent = self._silent(time)
        names = [
            f"{name} (silent for {silent[name]:.3g} s)" if name in silent else name
            for name, source in self._sources.items()
            if source.pressed
        ]
        return f"e-stop pressed at {', '.join(names)}" if names else ""

    def lost(self, time: int) -> str:
        """The released sources that are silent in one line, or that there is none, or ""."""
        if self._required and not self._sources:
            return "no source of the e-stop"
        lost = [
            f"{name} silent for {age:.3g} s"
            for name, age in self._silent(time).items()
            if not self._sources[name].pressed
        ]
        return (
            f"e-stop source {', '.join(lost)}, limit {self._limit:g} s" if lost else ""
        )

    def accept_losses(self, time: int) -> None:
        """Miss released sources that are silent no more, if another source is alive."""
        silent = self._silent(time)
        if len(silent) < len(self._sources):
            for name in silent:
                if not self._sources[name].pressed:
                    del self._sources[name]

    def forget(self, time: int, source: str) -> str:
        """Release the e-stop of a silent source and forget it; returns the reason of a refusal."""
        if source not in self._sources:
            known = ", ".join(self._sources) or "none"
            return f"{source}: no source of the e-stop; known: {known}"
        if source not in self._silent(time):
            return f"{source} still sends: release it there"
        del self._sources[source]
        return ""

    def _silent(self, time: int) -> dict[str, float]:
        """Time since the last message of each source that is silent, s."""
        ages = {
            name: to_seconds(time - s.received) for name, s in self._sources.items()
        }
        return {name: age for name, age in ages.items() if age > self._limit}
