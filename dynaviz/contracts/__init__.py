"""The contracts that plug-ins use: scans, methods, evidence, metrics, protocols, sensors and parameters."""
