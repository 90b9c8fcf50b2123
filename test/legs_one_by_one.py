"""Steps of a robot on rods with one leg after the other: the same equations in numbers, slower."""

from slot_core.compiled import kernel
from slot_core.dynamics.handle import Handle, contents
from slot_core.dynamics.integrator import advance_contents


def advance_one_by_one(sim, steps):
    """As `integrator.advance` of a robot's handle."""
    *parts, legs, scheme = sim.handle._content
    singly = tuple(of_leg(legs, leg) for leg in range(4))
    return _advance(Handle((*parts, singly, scheme)), steps)


def of_leg(legs, leg):
    """Views of the arrays of one leg, which those of four have as their last axis."""
    if isinstance(legs, tuple):
        return type(legs)(*(of_leg(part, leg) for part in legs))
    return legs[..., leg]


@kernel
def _advance(machine, steps):
    model, state, work, start, legs, scheme = contents(machine)
    return advance_contents(model, state, work, start, legs, scheme, steps)
