"""Tasks of one's own: found by name only where they are allowed, checked, and simulated by MuJoCo as they say."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from common.config.settings import RunSettings
from common.errors import SettingsError
from common.maths.trees import to_arrays
from common.physics import lookup
from common.physics.assets import model_xml, task_files
from common.physics.environments import make_environment
from common.physics.lookup import allow_import, load_definition
from common.physics.pinning import pinned
from common.physics.state_shapes import state_shapes

EXAMPLES = Path(__file__).parents[3] / "examples"
NAME = "double_pendulum:DoublePendulum"

GOOD = """
import jax.numpy as jnp
from reskpn.tasks import Task

class Slider(Task):
    mjcf = '''<mujoco><worldbody><body><joint name="x" type="slide"/><geom size=".1" mass="2"/></body></worldbody>
    <actuator><motor joint="x" gear="3"/></actuator></mujoco>'''
    def observation(self, data):
        return jnp.concatenate([data.qpos, data.qvel])
    def reward(self, before, action, after):
        return -after.qpos[0]
"""


@pytest.fixture(autouse=True)
def _nothing_allowed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A process that has allowed nothing, and whose modules of tests are forgotten."""
    monkeypatch.setattr(lookup, "_ALLOWED", set())
    lookup._load.cache_clear()
    before = set(sys.modules)
    yield
    lookup._load.cache_clear()
    for name in set(sys.modules) - before:
        if name in ("mine", "double_pendulum"):
            del sys.modules[name]


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the example, which is allowed and in the current folder."""
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.setattr(sys, "path", list(sys.path))
    allow_import(NAME)
    return NAME


Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """`write(old, new, ...)`: a module with `GOOD`, changed, in the current folder; the name of its class, allowed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def make(*changes: str) -> str:
        text = GOOD
        for old, new in zip(changes[::2], changes[1::2], strict=True):
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "mine.py").write_text(textwrap.dedent(text))
        allow_import("mine:Slider")
        return "mine:Slider"

    return make


def refusal(name: str) -> str:
    """The sentence with which a task is refused before anything is simulated."""
    with pytest.raises(SettingsError) as caught:
        pinned(RunSettings(task=name))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_example_moves_as_mujoco_moves_it(example: str) -> None:
    """Two substeps of MuJoCo under the scaled command: state, observation and reward; state arrays as announced."""
    environment = make_environment(example, "native", num_envs=2, threads=1)
    state = environment.reset(jax.random.key(1))
    action = jnp.array([[0.5, -1.0], [2.0, 0.0]])
    after, transition = environment.step(state, action)
    model = mujoco.MjModel.from_xml_path(str(EXAMPLES / "double_pendulum.xml"))
    for sim, ctrl in enumerate([[3.0, -3.0], [6.0, 0.0]]):  # half of 6, all of 3; 2 is clipped to 1
        data = mujoco.MjData(model)
        data.qpos, data.qvel = state.bodies.q[sim], state.bodies.qd[sim]
        mujoco.mj_forward(model, data)
        data.ctrl = ctrl
        mujoco.mj_step(model, data, 2)
        np.testing.assert_allclose(after.bodies.q[sim], data.qpos, atol=1e-6)
        wanted = np.concatenate([np.sin(data.qpos), np.cos(data.qpos), data.qvel])
        np.testing.assert_allclose(transition.next_obs[sim], wanted, atol=1e-5)
        effort = np.square(np.clip(np.asarray(action[sim]), -1, 1)).sum()
        assert float(transition.reward[sim]) == pytest.approx(data.site_xpos[0, 2] - 0.01 * effort, abs=1e-5)
    assert environment.step_s == pytest.approx(0.02)
    found = {path: (array.dtype.name, array.shape) for path, array in to_arrays(after).items()}
    assert found == state_shapes(pinned(RunSettings(task=example)).sizes, 2)


def test_its_pin_has_sizes_and_content_and_its_episodes_their_length(example: str) -> None:
    """6 observations, 2 actions, a digest; 500 steps unless the settings say otherwise."""
    settings = pinned(RunSettings(task=example))
    assert (settings.sizes.observation_size, settings.sizes.action_size) == (6, 2)
    assert settings.episode_length == 500
    assert pinned(RunSettings(task=example, episode_length=40)).episode_length == 40
    assert pinned(settings) == settings
    assert set(task_files(example)) == {"double_pendulum.doublependulum.xml", "double_pendulum.py"}
    assert model_xml(example).startswith("<mujoco")


def test_another_version_of_a_task_is_refused(write: Write) -> None:
    """Where the class's source differs from the one that the run's settings are pinned to."""
    settings = pinned(RunSettings(task=write()))
    lookup._load.cache_clear()
    del sys.modules["mine"]
    write("-after.qpos[0]", "-2 * after.qpos[0]")
    with pytest.raises(SettingsError, match="is not the one that the run began with"):
        pinned(settings)


def test_what_a_run_names_is_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A class that this process's user did not name is refused, and its module has not run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("raise SystemExit('ran')")
    settings = RunSettings(task="mine:Slider", task_pin="2x1-0123456789abcdef")
    with pytest.raises(SettingsError, match="code is not run because a run names it: allow it here by --task mine:Sli"):
        pinned(settings)
    with pytest.raises(SettingsError, match="allow it here"):
        make_environment("mine:Slider", "native", num_envs=1)
    assert "mine" not in sys.modules


def test_a_task_of_a_package_that_is_not_installed(tmp_path: Path) -> None:
    """A run of it can be read, but not continued here."""
    settings = RunSettings(task="my_robot", task_pin="2x1-0123456789abcdef")
    assert settings.sizes.observation_size == 2
    with pytest.raises(SettingsError, match="belongs to a package that is not installed here"):
        pinned(settings)


def test_a_typo_suggests_the_nearest_name(write: Write) -> None:
    """Of a class, of a module, and of a built-in task."""
    write()
    for name in ("mine:Sliders", "mne:Slider"):
        allow_import(name)
    assert "did you mean Slider?" in refusal("mine:Sliders")
    assert "did you mean mine?" in refusal("mne:Slider")
    with pytest.raises(ValueError, match="did you mean 'hopper-v5'"):
        RunSettings(task="hoper-v5")
    with pytest.raises(ValueError, match="write module:Class"):
        RunSettings(task="my-file.py:Slider")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (("def reward(self, before, action, after)", "def rewards(self, b, a, c)"), "Slider has no method reward"),
        (("mjcf =", "model_file ="), "class Slider has no model: set mjcf"),
        (("<joint ", "<jointt "), "its MJCF does not load: XML Error: Schema violation"),
        (('<motor joint="x" gear="3"/>', ""), "its MJCF has no actuator"),
        (("(Task)", ""), "Slider is not a task: derive it from reskpn.tasks.Task"),
        (("import jax.numpy as jnp", "import jax.nump as jnp"), "mine imports jax.nump, which is not installed"),
        (("class Slider", "1 / 0\nclass Slider"), "importing mine raises ZeroDivisionError: division by zero"),
        (("-after.qpos[0]", "-after.qpos"), r"reward() returns an array of shape (1,) where a single number is needed"),
        (("-after.qpos[0]", "1.0 if after.qpos[0] > 0 else 0.0"), "write jnp.where(condition, a, b)"),
        (("data.qpos, data.qvel", "data.qpos, data.xpos[1]"), "add 'xpos' to the task's `reads`"),
        (("data.qpos, data.qvel", "data.qpos, data.qvell"), "did you mean 'qvel'?"),
        (("return jnp.concatenate([data.qpos, data.qvel])", "return data.qpos[0]"), "where a vector of"),
        (("def obs", "reads = ('site_pos',)\n    def obs"), "did you mean 'site_xpos'?"),
        (
            ("return jnp.concatenate", "self.n = vars(self).get('n', 0) + 1; return jnp.tile(data.qpos, self.n) #"),
            "once and an array of shape (2,) another time",
        ),
        (("class Slider(Task):", "class Slider(Task):\n    def __init__(self, x): ..."), "made without arguments"),
        (("class Slider(Task):", "class Slider(Task):\n    frame_skip = 0"), "must be at least 1"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_task_is_said_in_one_sentence(write: Write, changes: Any, sentence: str) -> None:
    """Before anything is simulated, with the name of the function or the file and what to do."""
    assert sentence in refusal(write(*changes))


def test_a_path_that_is_not_there(write: Write) -> None:
    """The MJCF's path is in the sentence."""
    name = write('"""', '"""') if '"""' in GOOD else write("'''<mujoco>", "'nothing.xml' or '''<mujoco>")
    assert "nothing.xml cannot be read" in refusal(name)


def test_files_of_a_model_are_part_of_its_content(write: Write, tmp_path: Path) -> None:
    """An included file: its bytes are in the log's files, and a change of it is another task."""
    included = tmp_path / "option.xml"
    included.write_text('<mujoco><option timestep="0.01"/></mujoco>')
    (tmp_path / "model.xml").write_text(
        '<mujoco><include file="option.xml"/><worldbody><body><joint name="x" type="slide"/><geom size=".1"/></body>'
        '</worldbody><actuator><motor joint="x"/></actuator></mujoco>'
    )
    name = write("'''<mujoco>", "'model.xml' or '''<mujoco>")
    settings = pinned(RunSettings(task=name))
    assert task_files(name)["option.xml"] == included.read_bytes()
    assert load_definition(name).model.opt.timestep == 0.01
    lookup._load.cache_clear()
    included.write_text('<mujoco><option timestep="0.02"/></mujoco>')
    with pytest.raises(SettingsError, match="has changed"):
        pinned(settings)
