"""A recorded run as Parquet files: transitions, episodes, the metrics of every update, and evaluations.

Transitions are written as the log is read, a row group at a time; only the metrics of the updates are held in memory.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from common.errors import SettingsError
from common.remedies import remedy
from common.runs.recorded_run import RecordedRun
from common.runs.recorded_updates import RecordedUpdate
from common.wire.rollout import Rollout

ROLLOUTS, EPISODES, METRICS = "rollouts.parquet", "episodes.parquet", "metrics.parquet"
EVALUATIONS = "evaluations.parquet"
FILES = (ROLLOUTS, EPISODES, METRICS, EVALUATIONS)

_GROUP_BYTES = 32 << 20
"""Bytes of a row group before it is compressed."""

_RUN = (("run", pa.string()), ("task", pa.string()), ("learner", pa.string()), ("seed", pa.int64()))
"""First columns of every file, so that the files of several runs can be put together."""

_ORIGIN = (
    ("version", pa.int64()),
    ("slot", pa.int32()),
    ("incarnation", pa.string()),
    ("seq", pa.int64()),
)
"""Which update used a rollout (null: none), and the rollout's name."""


def extract(run: RecordedRun, folder: Path, on_update: Callable[[RecordedUpdate], None]) -> dict[str, int]:
    """Write the files of a run into `folder`, which is created; returns the number of rows of each.

    Each file is whole or absent.

    Args:
        on_update: called after each update.

    Raises:
        LogReadError: the log is damaged.
        SettingsError: a file is there already, or cannot be written.
    """
    try:
        if taken := [name for name in FILES if (folder / name).exists()]:
            raise SettingsError(
                f"{folder} already holds {', '.join(taken)}; choose another directory, or move them away"
            )
        folder.mkdir(parents=True, exist_ok=True)
        return _extract(run, folder, on_update)
    except OSError as error:
        raise SettingsError(f"{folder} cannot be written ({error.strerror or error}); {remedy(error)}") from None


def _extract(run: RecordedRun, folder: Path, on_update: Callable[[RecordedUpdate], None]) -> dict[str, int]:
    task = run.settings.sizes
    numbers = Numbers()
    settings = run.settings
    of_run: dict[str, int | str] = {
        "run": run.run,
        "task": settings.task,
        "learner": settings.learner,
        "seed": settings.seed,
    }
    with ExitStack() as stack:

        def table(name: str, schema: pa.Schema) -> _Table:
            return stack.enter_context(_table(folder / name, schema, of_run))

        schema = rollout_schema(task.observation_size, task.action_size)
        rollouts, episodes = table(ROLLOUTS, schema), table(EPISODES, EPISODE_SCHEMA)

        def add(rollout: Rollout, version: int | None) -> None:
            rollouts.add(_transitions(rollout, version, schema))
            episodes.add(_episodes(rollout, version))

        for update in run.updates(on_unused=lambda rollout: add(rollout, None)):
            for rollout in update.rollouts:
                add(rollout, update.version)
            numbers.add(update)
            on_update(update)
        batch = numbers.batch()
        metrics = table(METRICS, batch.schema)
        metrics.add(batch)
        evaluations = table(EVALUATIONS, EVALUATION_SCHEMA)
        evaluations.add(pa.RecordBatch.from_pylist(list(run.evaluations()), schema=EVALUATION_SCHEMA))
    written = {ROLLOUTS: rollouts, EPISODES: episodes, METRICS: metrics, EVALUATIONS: evaluations}
    return {name: file.rows for name, file in written.items()}


def rollout_schema(observation_size: int, action_size: int) -> pa.Schema:
    """Columns of the transitions: one row for each step `t` of each environment `env` of a rollout."""
    return pa.schema(
        [
            *_ORIGIN,
            ("policy_version", pa.int64()),
            ("t", pa.int32()),
            ("env", pa.int32()),
            ("observation", pa.list_(pa.float32(), observation_size)),
            ("action", pa.list_(pa.float32(), action_size)),
            ("log_prob", pa.float32()),
            ("reward", pa.float32()),
            ("terminated", pa.bool_()),
            ("truncated", pa.bool_()),
        ]
    )


EPISODE_SCHEMA = pa.schema([*_ORIGIN, ("return", pa.float32()), ("length", pa.int32())])
"""Columns of the episodes: one row for each that ended in a rollout."""


EVALUATION_SCHEMA = pa.schema(
    [
        ("version", pa.int64()),
        ("env_steps", pa.int64()),
        ("source", pa.string()),
        ("behind", pa.int64()),
        ("episodes", pa.int64()),
        *((f"return_{name}", pa.float64()) for name in ("mean", "std", "min", "max")),
        *((f"length_{name}", pa.float64()) for name in ("mean", "std")),
    ]
)
"""Columns of the evaluations: one row for each `/eval` message; null where an older release did not record a value."""


class Numbers:
    """The numbers of every update by column; eight bytes each, for a run may have very many."""

    def __init__(self) -> None:
        self._columns: dict[str, array[float]] = {}
        self._whole: dict[str, array[int]] = {name: array("q") for name in ("version", "env_steps", "t_ns")}
        self._digests: list[str] = []

    def add(self, update: RecordedUpdate) -> None:
        """Add a row. A value that only other updates have is null, as is one that was not finite."""
        rows = len(self._digests)
        returns = np.concatenate([rollout.episode_return for rollout in update.rollouts])
        values = {
            "episodes": float(len(returns)),
            "return": float(returns.mean(dtype=np.float64)) if len(returns) else None,
            **{f"staleness/{name}": value for name, value in update.staleness.items()},
            **{f"seconds/{name}": value for name, value in update.seconds.items()},
            **update.metrics,
        }
        for name in values.keys() - self._columns.keys():
            self._columns[name] = array("d", [np.nan]) * rows
        for name, column in self._columns.items():
            value = values.get(name)
            column.append(np.nan if value is None else value)
        for name, whole in self._whole.items():
            whole.append(getattr(update, name))
        self._digests.append(update.state_digest)

    def batch(self) -> pa.RecordBatch:
        """All rows."""
        columns: dict[str, Any] = {name: pa.array(np.array(whole)) for name, whole in self._whole.items()}
        columns["state_digest"] = pa.array(self._digests, pa.string())
        for name, column in sorted(self._columns.items()):
            columns[name] = pa.array(np.array(column), from_pandas=True)
        return pa.RecordBatch.from_pydict(columns)


class _Table:
    """A Parquet file that is being written."""

    def __init__(self, writer: parquet.ParquetWriter, schema: pa.Schema, of_run: Mapping[str, int | str]) -> None:
        self.rows = 0
        self._writer = writer
        self._schema = schema
        self._of_run = of_run
        self._batches: list[pa.RecordBatch] = []

    def add(self, batch: pa.RecordBatch) -> None:
        """Put rows at the end."""
        self.rows += batch.num_rows
        self._batches.append(batch)
        if sum(batch.nbytes for batch in self._batches) >= _GROUP_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the rows that are held as one row group."""
        table = pa.Table.from_batches(self._batches, self._schema)
        if table.num_rows:
            for place, (name, kind) in enumerate(_RUN):
                table = table.add_column(place, name, _constant(self._of_run[name], kind, table.num_rows))
            self._writer.write_table(table, row_group_size=table.num_rows)
        self._batches.clear()


@contextmanager
def _table(path: Path, schema: pa.Schema, of_run: Mapping[str, int | str]) -> Iterator[_Table]:
    """A table that becomes the file `path` at the end of the block; no file is left if the block raises.

    `of_run` has the values of the columns `_RUN`, which are put before those of the schema.
    """
    beside = path.with_suffix(".part")
    written = pa.schema([*_RUN, *schema])
    repeated = [name for name in written.names if written.field(name).type == pa.string()] + ["seed"]
    try:
        # Floats hardly repeat: a dictionary of their values would only cost time.
        with parquet.ParquetWriter(beside, written, use_dictionary=repeated) as writer:
            table = _Table(writer, schema, of_run)
            yield table
            table.flush()
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _transitions(rollout: Rollout, version: int | None, schema: pa.Schema) -> pa.RecordBatch:
    steps, envs = rollout.reward.shape
    columns = {
        **_origin(rollout, version, steps * envs),
        "policy_version": _constant(rollout.policy_version, pa.int64(), steps * envs),
        "t": pa.array(np.repeat(np.arange(steps, dtype=np.int32), envs)),
        "env": pa.array(np.tile(np.arange(envs, dtype=np.int32), steps)),
        "observation": _vectors(rollout.obs),
        "action": _vectors(rollout.action),
    }
    for name in ("log_prob", "reward", "terminated", "truncated"):
        columns[name] = pa.array(getattr(rollout, name).reshape(-1))
    return pa.RecordBatch.from_arrays([columns[name] for name in schema.names], schema=schema)


def _episodes(rollout: Rollout, version: int | None) -> pa.RecordBatch:
    columns = {
        **_origin(rollout, version, len(rollout.episode_return)),
        "return": pa.array(rollout.episode_return),
        "length": pa.array(rollout.episode_length),
    }
    return pa.RecordBatch.from_arrays([columns[name] for name in EPISODE_SCHEMA.names], schema=EPISODE_SCHEMA)


def _origin(rollout: Rollout, version: int | None, rows: int) -> dict[str, Any]:
    values = {"version": version, "slot": rollout.slot, "incarnation": rollout.incarnation, "seq": rollout.seq}
    return {name: _constant(values[name], kind, rows) for name, kind in _ORIGIN}


def _constant(value: int | str | None, kind: pa.DataType, rows: int) -> pa.Array:
    return pa.nulls(rows, kind) if value is None else pa.repeat(pa.scalar(value, kind), rows)


def _vectors(values: np.ndarray) -> pa.Array:
    """[T, N, X] as T * N lists of X numbers."""
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[-1])
