"""Where settings come from: which place wins, and what is said of what cannot be read."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from common.config.faults import COMMAND_LINE, ENVIRONMENT, spelled
from common.config.kinds import written
from common.config.presets import PRESETS, default_settings
from common.config.settings import RunSettings
from common.config.sources import add_options, load, load_over, parse_json
from common.config.tree import leaves, value_of
from common.errors import SettingsError


@pytest.fixture
def config(tmp_path: Path) -> Any:
    """Writes a file of settings and returns its name."""

    def write(text: str) -> str:
        path = tmp_path / "settings.yaml"
        path.write_text(text)
        return str(path)

    return write


def loaded(*words: str, environment: dict[str, str] | None = None, config: str | None = None) -> RunSettings:
    """The settings out of these words of a command line, this environment and this file."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    options = add_options(parser)
    arguments = parser.parse_args([*words, *(["--config", config] if config else [])])
    return load(options, arguments, config=arguments.config, environment=environment or {})


def refusal(*words: str, environment: dict[str, str] | None = None, config: str | None = None) -> str:
    with pytest.raises(SettingsError) as refused:
        loaded(*words, environment=environment, config=config)
    return str(refused.value)


# -- which place wins --------------------------------------------------------------------------------------


def test_without_anything_said_there_are_the_defaults() -> None:
    """From every place that is empty."""
    assert loaded() == default_settings()
    assert load(environment={}) == default_settings()


PLACES = ("command line", "environment", "file")


@pytest.mark.parametrize("winner", range(4))
@pytest.mark.parametrize(
    ("option", "variable", "yaml", "read", "default"),
    [
        ("--seed", "RESKPN_SEED", "seed: {}", lambda s: s.seed, 0),
        (
            "--algorithm.minibatches",
            "RESKPN_ALGORITHM__MINIBATCHES",
            "algorithm: {{minibatches: {}}}",
            lambda s: s.algorithm.minibatches,
            32,
        ),
        ("--rkhs.directions", "RESKPN_RKHS__DIRECTIONS", "rkhs: {{directions: {}}}", lambda s: s.rkhs.directions, 8),
    ],
)
def test_precedence(
    winner: int, option: str, variable: str, yaml: str, read: Any, default: object, config: Any
) -> None:
    """Command line over environment over file over defaults: the places from the winner on say 1, 2 and 4."""
    words, environment, file = [option, "1"], {variable: "2"}, config(yaml.format(4))
    settings = loaded(
        *(words if winner == 0 else []),
        environment=environment if winner <= 1 else {},
        config=file if winner <= 2 else None,
    )
    assert read(settings) == [1, 2, 4, default][winner]


def test_every_place_counts_for_what_it_says(config: Any) -> None:
    """The fields of one section may come from three places."""
    file = config("algorithm:\n  gamma: 0.1\n  gae_lambda: 0.1\n  clip: 0.1\nseed: 3\n")
    settings = loaded(
        "--algorithm.gamma",
        "0.3",
        environment={"RESKPN_ALGORITHM__GAMMA": "0.2", "RESKPN_ALGORITHM__GAE_LAMBDA": "0.2"},
        config=file,
    )
    algorithm = settings.algorithm
    # gamma from the command line, gae_lambda from the environment, clip from the file, epochs by default
    assert (algorithm.gamma, algorithm.gae_lambda, algorithm.clip, algorithm.epochs) == (0.3, 0.2, 0.1, 4)
    assert settings.seed == 3


def test_a_section_as_json_is_merged_with_its_fields() -> None:
    """In the environment; the single field wins."""
    settings = load(environment={"RESKPN_ALGORITHM": '{"gamma": 0.5, "epochs": 2}', "RESKPN_ALGORITHM__EPOCHS": "3"})
    assert (settings.algorithm.gamma, settings.algorithm.epochs) == (0.5, 3)


def test_the_environment_is_that_of_the_process_unless_one_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """As for a service in a container."""
    monkeypatch.setenv("RESKPN_SEED", "11")
    assert load().seed == 11
    assert load(environment={}).seed == 0


@pytest.mark.parametrize(
    "place",
    [
        {"words": ["--total-steps", "3e6", "--rkhs.capacity", "1e2", "--algorithm.hidden", "8,1.6e1"]},
        {
            "environment": {
                "RESKPN_TOTAL_STEPS": "3e6",
                "RESKPN_RKHS__CAPACITY": "1e2",
                "RESKPN_ALGORITHM__HIDDEN": "[8, 1.6e1]",
            }
        },
        {"file": "total_steps: 3e6\nrkhs: {capacity: 1e2}\nalgorithm: {hidden: [8, 1.6e1]}\n"},
    ],
    ids=PLACES,
)
def test_short_numbers_in_every_place(place: dict[str, Any], config: Any) -> None:
    """`3e6` is a whole number wherever it is written (YAML 1.1 calls it a text)."""
    file = config(place["file"]) if "file" in place else None
    settings = loaded(*place.get("words", []), environment=place.get("environment"), config=file)
    assert (settings.total_steps, settings.rkhs.capacity, settings.algorithm.hidden) == (3_000_000, 100, (8, 16))


def test_options_are_spelled_with_hyphens_and_take_values() -> None:
    """Also flags, lists and paths."""
    settings = loaded(
        "--algorithm.gae-lambda=0.5",
        "--algorithm.normalise-rewards=false",
        "--algorithm.hidden=[4,4]",
        "--run-dir=a/b",
        "--transport.insecure=true",
    )
    assert (settings.algorithm.gae_lambda, settings.algorithm.normalise_rewards) == (0.5, False)
    assert (settings.algorithm.hidden, settings.run_dir) == ((4, 4), Path("a/b"))
    assert settings.transport.insecure is True


# -- files and presets -------------------------------------------------------------------------------------


def test_an_empty_file_says_nothing(config: Any) -> None:
    """Nor does one with nothing but comments."""
    assert loaded(config=config("# nothing\n")) == default_settings()


def test_settings_written_as_json_are_a_file_of_settings(config: Any) -> None:
    """So a run's settings.json starts the same run again, to the last bit of every number."""
    settings = RunSettings.model_validate(
        {"algorithm": {"adam_eps": 1e-5, "learning_rate": 3e-4, "gamma": 0.1 + 0.2}, "rkhs": {"eta": 1e-300}}
    )
    assert loaded(config=config(settings.model_dump_json())) == settings


def test_the_preset_paper_is_table_1() -> None:
    """Every number of the paper's Table 1 (column ResKPN), and the number of its steps."""
    settings = loaded(config="paper")
    algorithm, rkhs = settings.algorithm, settings.rkhs
    assert algorithm.learning_rate == 3e-4  # Learning Rate
    assert rkhs.eta == 1e-1  # Learning Rate for RKHS
    assert rkhs.momentum == 0.9  # Adam for RKHS
    assert algorithm.max_grad_norm == 0.5  # Max Gradient Norm
    assert settings.num_envs == 2048  # Number of Environments in Parallel
    assert settings.num_steps == 10  # Number of Steps per Update
    assert settings.total_steps == 5 * 10**7  # Total Timesteps
    assert algorithm.minibatches == 32  # Number of Minibatches
    assert algorithm.gae_lambda == 0.95  # GAE Lambda
    assert algorithm.clip == 0.2  # Clip Epsilon
    assert rkhs.clip == 1  # Clip Epsilon for RKHS
    assert (algorithm.dpo_alpha, algorithm.dpo_beta) == (2.0, 0.6)  # DPO Alpha, DPO Beta
    assert (rkhs.drift_alpha, rkhs.drift_beta) == (1, 0.6)  # DPO Alpha RKHS, DPO Beta RKHS
    assert algorithm.hidden[-1] == 256  # Feature Dimension
    # Section B.3: environments run for 1000 steps. Section 5: one transition for each functional gradient.
    assert settings.episode_length == 1000
    assert rkhs.samples == 1
    assert settings.capacity == settings.updates == 2441


def test_a_preset_can_be_changed() -> None:
    """As any file."""
    settings = loaded("--task", "hopper", config="paper")
    assert (settings.task, settings.total_steps) == ("hopper", 50_000_000)


@pytest.mark.parametrize(
    ("name", "why"),
    [("nowhere.yaml", "No such file or directory"), (".", "Is a directory")],
)
def test_a_file_that_cannot_be_read(tmp_path: Path, name: str, why: str) -> None:
    """The reason, and what could be given instead."""
    path = tmp_path / name
    assert refusal(config=str(path)) == (
        f"--config {path}: cannot be read ({why}); give a YAML file or one of the presets: {', '.join(PRESETS)}"
    )


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    """A log or a checkpoint given by mistake."""
    path = tmp_path / "x"
    path.write_bytes(b"\xff\xfe\x00\x80")
    assert refusal(config=str(path)) == f"--config {path}: not a text file; give a YAML file of settings"


@pytest.mark.parametrize("text", ["a: [", "a: b: c", "\ttask: hopper", "@"])
def test_a_file_that_is_no_yaml(config: Any, text: str) -> None:
    """One line, with the place of the fault."""
    path = config(text)
    said = refusal(config=path)
    assert said.startswith(f"--config {path}: not valid YAML: ")
    assert "line 1" in said
    assert "\n" not in said


@pytest.mark.parametrize("text", ["[1, 2]", "hopper", "3"])
def test_a_file_that_is_no_mapping(config: Any, text: str) -> None:
    """With an example of one."""
    path = config(text)
    assert refusal(config=path) == f"--config {path}: must be a mapping of settings, such as 'task: hopper'"


def test_a_file_cannot_run_anything(config: Any) -> None:
    """YAML's tags for Python objects are not followed."""
    assert "not valid YAML" in refusal(config=config("!!python/object/apply:os.getcwd []"))


# -- names that are none -----------------------------------------------------------------------------------


def test_unknown_names_in_a_file(config: Any) -> None:
    """The nearest of the same section, and where it was said."""
    path = config("tsak: hopper\nalgorithm: {gama: 0.9}\n")
    first, second = refusal(config=path).splitlines()
    assert first == f"algorithm.gama (from {path}) is not a setting; did you mean algorithm.gamma?"
    assert second == f"tsak (from {path}) is not a setting; did you mean task?"


def test_a_dotted_name_in_a_file(config: Any) -> None:
    """As on the command line, and wrong in YAML: say how it is written. Other dotted names are unknown names."""
    path = config("algorithm.gamma: 0.9\n")
    assert refusal(config=path) == (
        f"algorithm.gamma (from {path}) is not a setting; in a file, write 'gamma' indented under 'algorithm':"
    )
    assert f"foo.qqq (from {path}) is not a setting; docs/settings.md" in refusal(config=config("foo.qqq: 1\n"))


def test_unknown_names_in_the_environment() -> None:
    """A typing error there is not passed over either."""
    for given, near in (
        ("RESKPN_TSAK", "RESKPN_TASK"),
        ("RESKPN_ALGORITHM__GAMA", "RESKPN_ALGORITHM__GAMMA"),
        ("RESKPN_ALGORITHM_GAMMA", "RESKPN_ALGORITHM__GAMMA"),  # one underscore is missing
        ("RESKPN_GAMMA", "RESKPN_ALGORITHM__GAMMA"),
        ("RESKPN_TASK__NAME", "RESKPN_TASK"),
    ):
        assert refusal(environment={given: "1"}) == (
            f"{given} (from the environment) is not a setting; did you mean {near}?"
        )


def test_other_variables_of_the_environment() -> None:
    """Only RESKPN_ ones are looked at, and the cache's folder is no setting of a run."""
    assert load(environment={"TASK": "x", "KPN_TASK": "x", "RESKPN_CACHE_DIR": "x"}) == default_settings()


# -- values that are none ----------------------------------------------------------------------------------


@pytest.mark.parametrize("place", PLACES)
def test_a_fault_is_told_with_what_was_given_and_where(place: str, config: Any) -> None:
    """Setting, place, value, reason."""
    places: dict[str, dict[str, Any]] = {
        "command line": {"words": ["--algorithm.gamma", "two"]},
        "environment": {"environment": {"RESKPN_ALGORITHM__GAMMA": "two"}},
        "file": {"config": config("algorithm: {gamma: two}")},
    }
    given = places[place]
    source = given["config"] if place == "file" else f"the {place}"
    assert refusal(*given.pop("words", []), **given) == (
        f"algorithm.gamma (from {source}): 'two': Input should be a valid number, unable to parse string as a number"
    )


def test_the_place_is_that_of_the_value_that_won(config: Any) -> None:
    """Not one further down, which may be right."""
    said = refusal("--seed", "-1", environment={"RESKPN_SEED": "1"}, config=config("seed: 2"))
    assert said == "seed (from the command line): '-1': Input should be greater than or equal to 0"


def test_an_element_of_a_list(config: Any) -> None:
    """Named by its place in the list."""
    path = config("algorithm: {hidden: [8, wide]}")
    assert refusal(config=path).startswith(f"algorithm.hidden.1 (from {path}): 'wide': Input should be a valid integer")


def test_all_faults_are_told_at_once(config: Any) -> None:
    """One line each."""
    said = refusal("--task", "hoper", environment={"RESKPN_SEED": "-1"}, config=config("rkhs: {eta: -1}"))
    assert [line.split(":")[0] for line in said.splitlines()] == [
        "task (from the command line)",
        "seed (from the environment)",
        f"rkhs.eta (from {said.splitlines()[2].split('(from ')[1].split(')')[0]})",
    ]


def test_a_combination_has_no_place() -> None:
    """It is of several settings, which are named with their numbers."""
    assert refusal("--num-envs", "7").startswith("num_envs (7) must be a multiple of actors (2)")


def test_a_section_that_is_none(config: Any) -> None:
    """A value where a section should be, and an empty section."""
    path = config("algorithm: 3")
    assert refusal(config=path).startswith(f"algorithm (from {path}): 3: Input should be a valid dictionary")
    path = config("algorithm:\n")
    assert refusal(config=path).startswith(f"algorithm (from {path}): None: ")


@pytest.mark.parametrize("text", ["8,16", "[8, 16]", "8, 16", " [8,16,] "])
@pytest.mark.parametrize("place", PLACES)
def test_lists_have_one_notation(place: str, text: str, config: Any) -> None:
    """In every source, with brackets or without."""
    places: dict[str, dict[str, Any]] = {
        "command line": {"words": ["--algorithm.hidden", text]},
        "environment": {"environment": {"RESKPN_ALGORITHM__HIDDEN": text}},
        "file": {"config": config(f"algorithm: {{hidden: {text!r}}}")},
    }
    given = places[place]
    assert loaded(*given.pop("words", []), **given).algorithm.hidden == (8, 16)


def test_lists_of_names() -> None:
    """One is enough; quotes as in JSON are taken, too."""
    for text in ("alice", "[alice]", '["alice"]'):
        assert loaded("--transport.actor-names", text).transport.actor_names == ("alice",)
        assert loaded(environment={"RESKPN_TRANSPORT__ACTOR_NAMES": text}).transport.actor_names == ("alice",)


@pytest.mark.parametrize("place", PLACES)
def test_one_number_is_no_list(place: str, config: Any) -> None:
    """It is not quietly a network of one layer; brackets say that one is meant."""
    places: dict[str, dict[str, Any]] = {
        "command line": {"words": ["--algorithm.hidden", "256"]},
        "environment": {"environment": {"RESKPN_ALGORITHM__HIDDEN": "256"}},
        "file": {"config": config("algorithm: {hidden: 256}")},
    }
    given = places[place]
    assert refusal(*given.pop("words", []), **given).endswith(
        ": write 256,256 for two layers, or [256] for a single one"
    )
    assert loaded("--algorithm.hidden", "[256]").algorithm.hidden == (256,)


def test_every_default_can_be_pasted() -> None:
    """As `--help`, docs/settings.md and .env.example print it, from the command line and from the environment."""
    texts = {name: text for name in leaves() if (text := written(value_of(default_settings(), name)))}
    assert loaded(*(f"{spelled(name, COMMAND_LINE)}={text}" for name, text in texts.items())) == default_settings()
    assert loaded(environment={spelled(name, ENVIRONMENT): text for name, text in texts.items()}) == default_settings()
    assert (written((256, 256)), written((256,)), written(("a",)), written(False)) == ("256,256", "[256]", "a", "false")


def test_keys_that_are_no_names(config: Any) -> None:
    """YAML may have numbers there."""
    path = config("1: 2")
    assert refusal(config=path) == f"1 (from {path}): 1: Keys should be strings"


def test_what_a_learner_sends_is_named_as_its_source() -> None:
    """An actor's user must know where to look."""
    with pytest.raises(SettingsError) as refused:
        parse_json(json.dumps({"seed": -1}))
    assert str(refused.value) == (
        "settings that a learner wrote cannot be used here: seed: -1: Input should be greater than or equal to 0"
    )


def test_a_recorded_run_stands_in_for_the_defaults(tmp_path: Path) -> None:
    """Whatever speaks takes precedence."""
    recorded = RunSettings(task="hopper", num_steps=20, seed=3, run_dir=tmp_path)
    settings = load_over(recorded, environment={"RESKPN_SEED": "4"})
    assert (settings.task, settings.num_steps, settings.seed, settings.run_dir) == ("hopper", 20, 4, tmp_path)
