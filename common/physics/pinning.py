"""The pin of a task of one's own: its sizes and a digest of its content, which all processes of a run must agree on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from pydantic import ValidationError

from common.config.faults import explain
from common.config.settings import RunSettings
from common.errors import SettingsError
from common.physics.assets import task_files
from common.physics.lookup import load_definition, require_allowed
from common.physics.task_checks import observation_size
from common.tasks import is_own, pin_of


def digest_of(files: Mapping[str, bytes]) -> str:
    """SHA-256, in hex, of a task's files by name (`task_files`)."""
    digest = hashlib.sha256()
    for name in sorted(files):
        for part in (name.encode(), files[name]):
            digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()


def pin_here(name: str) -> str:
    """The pin of a task as it is on this machine. SettingsError where it may not be imported, or is no task."""
    task = load_definition(name)
    return pin_of(observation_size(name, task), int(task.model.nu), digest_of(task_files(name)))


def pinned(settings: RunSettings) -> RunSettings:
    """The settings with the pin of their task, if it is one's own, and with its episode length unless they set one.

    Raises:
        SettingsError: the task may not be imported here, is no task, or is not the one that the settings are pinned to.
    """
    if not is_own(settings.task):
        return settings
    require_allowed(settings.task)
    here = pin_here(settings.task)
    if settings.task_pin is not None:
        if settings.task_pin != here:
            raise SettingsError(
                f"task {settings.task} here ({here}) is not the one that the run began with ({settings.task_pin}): its "
                "class or its model has changed; use the same version of its files wherever the run has a process"
            )
        return settings
    changes: dict[str, object] = {"task_pin": here}
    if "episode_length" not in settings.model_fields_set:
        changes["episode_length"] = load_definition(settings.task).episode_length
    changed = settings.model_copy(update=changes)
    try:
        RunSettings.model_validate(changed.model_dump())
    except ValidationError as error:
        raise SettingsError(explain(error, [])) from None
    return changed
