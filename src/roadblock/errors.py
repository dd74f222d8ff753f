"""The errors a user can meet.

Each message says, in one line, what was found, what was expected and what to do. The library raises;
only the command line prints and exits (code 2).
"""


class RoadblockError(Exception):
    """Anything a user can put right: a file, a setting, a rig, an installation."""


class ValueRefusedError(RoadblockError):
    """A value that cannot be true: wrong shape, not finite, not a rotation, impossible size."""


class RigError(RoadblockError):
    """A rig file or a rig that cannot be trusted."""


class SourceError(RoadblockError):
    """A recording that cannot be opened or read."""


class CalibrationError(RoadblockError):
    """A set of calibration views that cannot be used."""


class SettingsError(RoadblockError):
    """A setting that does not exist or does not fit."""


class OutputError(RoadblockError):
    """A result that cannot be written."""


class MissingExtraError(RoadblockError):
    """An optional library that is needed here and not installed."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(
            f"{feature} needs an optional library that is not installed; "
            f"install it with: pip install 'roadblock[{extra}]'"
        )
