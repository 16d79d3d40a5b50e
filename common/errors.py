"""The errors that a user can meet, as one tree.

    ReskpnError
    ├── SettingsError      a setting that is not possible (exit code 2)
    ├── WireError
    │   ├── CodecError     bytes that are not a valid message; `.reason` is the slug it is counted by
    │   ├── SessionError   no Zenoh session: port in use, peer unreachable, refused (exit code 3)
    │   └── RefusedError   the other side refused, with its reason (exit code 4)
    ├── LogError
    │   ├── LogWriteError  the log cannot be written: disk full, no permission (exit code 5)
    │   └── LogReadError   a log that is missing, foreign or damaged (exit code 5)
    ├── CheckpointError    a checkpoint that is missing, damaged or of another run (exit code 5)
    ├── PolicyFileError    a file that is no exported policy, or an observation that does not fit it (exit code 5)
    ├── PhysicsError       an engine that is missing, or a simulation that failed (exit code 6)
    ├── NumericsError      a quantity of the update is not finite (exit code 7)
    └── ProcessError       a process of the run ended although it should not (exit code 8)

Each message says what was given, what is allowed and what to do. The command line prints the message
alone, without a traceback, and exits with the class's `exit_code`.
"""

from __future__ import annotations

INTERRUPTED = 130
"""Exit code of a command that was asked to stop, as a shell reports Ctrl-C."""


class ReskpnError(Exception):
    """Root of the tree: everything that this package raises on purpose."""

    exit_code = 1


class SettingsError(ReskpnError):
    exit_code = 2


class WireError(ReskpnError):
    exit_code = 3


class CodecError(WireError):
    """Bytes that are not a valid message.

    `reason` is one lower-case slug out of a small set ("too_large", "bad_shape", ...): by which refusals are counted.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class SessionError(WireError):
    exit_code = 3


class RefusedError(WireError):
    exit_code = 4


class LogError(ReskpnError):
    exit_code = 5


class LogWriteError(LogError):
    pass


class LogReadError(LogError):
    pass


class CheckpointError(ReskpnError):
    exit_code = 5


class PolicyFileError(ReskpnError):
    exit_code = 5


class PhysicsError(ReskpnError):
    exit_code = 6


class NumericsError(ReskpnError):
    exit_code = 7


class ProcessError(ReskpnError):
    exit_code = 8
