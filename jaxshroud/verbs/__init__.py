"""The verbs: functions that take scenes and return results."""
