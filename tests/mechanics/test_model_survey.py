"""The script that compares public models with Pinocchio and MuJoCo, on the models of this repository."""

from pathlib import Path

import pytest
from model_survey import BOUND, Mujoco, Pinocchio, difference, main

from twistax import mechanics

pytest.importorskip("mujoco", reason="mujoco is not installed (extra twistax[models])")
pytest.importorskip("pinocchio", reason="pinocchio is not installed (extra twistax[peers])")

MODELS = Path(__file__).parent / "models"


def test_the_models_of_this_repository_agree(capsys: pytest.CaptureFixture[str], unchecked: None) -> None:
    """The machine takes meshes that are not there, which MuJoCo by itself does not read."""
    main([str(MODELS)])
    table = capsys.readouterr().out
    assert "| models | URDF | 1 | 1 | 0 | 1 | 0 | 0 | 0 |" in table
    assert "| models | MJCF | 0 | 0 | 0 | 0 | 0 | 0 | 1 |" in table


def test_another_mass_or_place_differs(tmp_path: Path, unchecked: None) -> None:
    """By ten times the bound, in each kind of file."""
    hand, text = MODELS / "hand.urdf", (MODELS / "hand.urdf").read_text()
    robot = mechanics.load(hand, quarter_turns=0.0)
    for old, new in (
        ('<mass value="0.15"/>', '<mass value="0.150000000002"/>'),
        ("0 0.04 0.02", "0 0.040000000002 0.02"),
    ):
        assert old in text
        other = tmp_path / "hand.urdf"
        other.write_text(text.replace(old, new))
        assert (
            difference(robot, Pinocchio(hand, floating=False))
            <= BOUND
            < difference(robot, Pinocchio(other, floating=False))
        )
    path = tmp_path / "model.xml"
    model = "<mujoco><worldbody><body><joint/><geom size='0.1' pos='{} 0 0'/></body></worldbody></mujoco>"
    path.write_text(model.format(0.3))
    arm = mechanics.load(path, quarter_turns=0.0)
    assert difference(arm, Mujoco(path)) <= BOUND
    path.write_text(model.format(0.300000000002))
    assert difference(arm, Mujoco(path)) > BOUND
