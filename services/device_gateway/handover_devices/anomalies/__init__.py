"""Anomalies: rules on the values of devices, which raise Alerts and may start a process."""
