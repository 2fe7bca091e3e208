"""Movers implanted into recorded scans, with exact ground truth.

The modules: ``survey`` accumulates the scans, ``space`` finds ground and free space, ``plan``
chooses paths, ``scene`` stores them, ``lidar`` measures the sensor, ``cast`` changes one scan,
``sequence`` is the result.
"""
