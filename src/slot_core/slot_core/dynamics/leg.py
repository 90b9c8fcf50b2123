"""Functions of kernels that exist for planar and for spatial legs, chosen by the leg's type."""

# mypy: disable-error-code="no-untyped-def,misc"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import overload

from slot_core.compiled import INLINE, OPTIONS
from slot_core.dynamics.planar import elimination as planar_elimination
from slot_core.dynamics.planar import leg as planar
from slot_core.dynamics.planar import strain as planar_strain
from slot_core.dynamics.spatial import elimination as spatial_elimination
from slot_core.dynamics.spatial import leg as spatial
from slot_core.dynamics.spatial import strain as spatial_strain

SPATIAL = {spatial.SpatialLeg, spatial_strain.Segments}


def _by_leg(planar_one: Callable[..., Any], spatial_one: Callable[..., Any]) -> Callable[..., Any]:
    """A function of kernels that is one of the two, by the leg or segments among its arguments."""

    def chosen(*arguments):
        raise NotImplementedError("only in kernels")

    @overload(chosen, jit_options=OPTIONS | INLINE)  # type: ignore[arg-type]
    def choose(*arguments):
        kinds = [getattr(kind, "instance_class", None) for kind in arguments]
        function = planar_one if SPATIAL.isdisjoint(kinds) else spatial_one
        return lambda *arguments: function(*arguments)  # noqa: PLW0108 - not a dispatcher

    return chosen


predict = _by_leg(planar.predict, spatial.predict)
stage = _by_leg(planar.stage, spatial.stage)
load_leg = _by_leg(planar.load_leg, spatial.load_leg)
eliminate = _by_leg(planar_elimination.eliminate, spatial_elimination.eliminate)
substitute = _by_leg(planar_elimination.substitute, spatial_elimination.substitute)
advance_bristles = _by_leg(planar.advance_bristles, spatial.advance_bristles)
finish = _by_leg(planar.finish, spatial.finish)
elastic_energy = _by_leg(planar_strain.elastic_energy, spatial_strain.elastic_energy)
