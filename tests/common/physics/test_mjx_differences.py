"""Models that MJX would simulate otherwise are told by the name of their part; others are not."""

from __future__ import annotations

import mujoco
import pytest

from common.physics.lookup import load_definition
from common.physics.mjx_differences import mjx_differences

JOINT = '<joint name="knee" type="slide" {}/><geom name="g" size=".1"/>'
MODEL = """<mujoco><option {option}/><worldbody><body>{joint}<site name="moving"/></body>{world}</worldbody>
<actuator><motor joint="knee"/></actuator>{rest}</mujoco>"""


def told(option: str = "", joint: str = "", world: str = "", rest: str = "", body: str = JOINT) -> list[str]:
    """The sentences about a slider with these attributes and parts."""
    text = MODEL.format(option=option, joint=body.format(joint), world=world, rest=rest)
    return mjx_differences(mujoco.MjModel.from_xml_string(text))


TENDON = '<tendon><spatial name="cord"><site site="moving"/><geom geom="g"{}/><site site="end"/></spatial></tendon>'
END = '<site name="end" pos="1 0 0"/><site name="side" pos="0 0 1"/>'
MAST = '<body><geom size=".1"/><site name="mast"/></body>'
SENSOR = '<sensor><accelerometer name="{0}" site="{0}"/></sensor>'


@pytest.mark.parametrize(
    ("model", "opening"),
    [
        (
            {"option": 'integrator="implicitfast"', "joint": 'actuatorfrcrange="-1 1"'},
            "joint knee: at actuatorfrcrange",
        ),
        ({"world": END, "rest": TENDON.format(' sidesite="side"')}, "tendon cord: with a sidesite"),
        ({"joint": 'stiffness="100" springyield=".02"'}, "joint knee: a spring that yields"),
        (
            {"option": 'integrator="RK4"', "world": '<body name="box"><freejoint/><geom size=".1"/></body>'},
            "free joint box: with integrator RK4",
        ),
        ({"world": MAST, "rest": SENSOR.format("mast")}, "accelerometer mast: on a body without joints"),
    ],
)
def test_each_difference_is_told_by_name(model: dict[str, str], opening: str) -> None:
    """One sentence, which opens with the part's kind and name."""
    (sentence,) = told(**model)
    assert sentence.startswith(opening)


@pytest.mark.parametrize(
    "model",
    [
        {},
        {"joint": 'actuatorfrcrange="-1 1"'},
        {"option": 'integrator="implicitfast"'},
        {"world": END, "rest": TENDON.format("")},
        {"joint": 'stiffness="100"'},
        {"option": 'integrator="RK4"'},
        {"world": '<body name="box"><freejoint/><geom size=".1"/></body>'},
        {"rest": SENSOR.format("moving")},
    ],
)
def test_half_of_a_difference_is_none(model: dict[str, str]) -> None:
    """The limit without the integrator, the tendon without the sidesite, and so on."""
    assert not told(**model)


def test_gymnasiums_tasks_and_their_differences() -> None:
    """The ant is a free joint under RK4; the hopper has no free joint."""
    assert [sentence.split(":")[0] for sentence in mjx_differences(load_definition("ant-v5").model)] == [
        "free joint root"
    ]
    assert not mjx_differences(load_definition("hopper-v5").model)
