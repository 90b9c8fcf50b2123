"""Functions before kernels, and others of the core, refuse arrays that a kernel could not read."""

import pytest

from benchmarks.fuzz.hostile_calls import GROUPS, wrong


@pytest.mark.parametrize("group", GROUPS)
def test_arrays_of_wrong_shapes_types_and_values_are_refused(group):
    for name, case in GROUPS[group]().items():
        refused = list(wrong(case))
        assert len(refused) > 1
        for what, values in refused:
            with pytest.raises(ValueError, match=r"^.{,300}$"):  # noqa: PT012
                case.call(*values)
                pytest.fail(f"{name}, {what}: accepted")
        case.call(*case.good)
