"""The boxes of the flow chart: functions from values to values, blind to each other."""
