"""Animation of a walk: its frames, its speed, and what it refuses."""

import pytest
from PIL import Image
from synthetic_walk import STRIDE, Walk, write_walk

from slot_core.recording.record_settings import BagError
from slot_lab.bags.bag import Bag
from slot_lab.report import robot_drawing
from slot_lab.report.robot_drawing import animate, frame_times

RATE = 30  # Hz, of the leg shapes


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return Bag(write_walk(tmp_path_factory.mktemp("bags") / "walk", Walk(duration=1.6)))


def test_it_shows_the_last_strides_without_repeating_its_first_frame(bag):
    times = frame_times(bag)
    assert times[-1] == pytest.approx(Walk().start + 1.6)
    assert len(times) == round(robot_drawing.STRIDES * STRIDE * RATE)
    assert times[-1] - times[0] < robot_drawing.STRIDES * STRIDE


def test_the_file_moves_in_a_loop_at_half_the_speed(bag, tmp_path, monkeypatch):
    monkeypatch.setattr(robot_drawing, "frame_times", lambda bag: frame_times(bag)[:3])
    animate(bag, tmp_path / "walk.gif")
    with Image.open(tmp_path / "walk.gif") as plot:
        assert plot.n_frames == 3
        assert plot.info["loop"] == 0
        assert plot.info["duration"] == pytest.approx(
            1e3 * 2 / RATE, abs=10
        )  # GIF: in 10 ms


def test_a_bag_without_leg_shapes_is_refused(tmp_path):
    blind = Bag(write_walk(tmp_path / "blind", Walk(duration=0.2, truth=False)))
    with pytest.raises(BagError, match="no topic /ground_truth/legs"):
        animate(blind, tmp_path / "walk.gif")
