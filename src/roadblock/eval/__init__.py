"""Judges: functions of plain records and truth, so that any other system's output can be judged too."""
