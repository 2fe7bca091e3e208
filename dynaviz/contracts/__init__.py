"""The contracts that plug-ins use.

Scans, methods, evidence, metrics, protocols, sensors and parameters.
"""
