"""What a source means: interpretations of the same files and numbers compete.

Names of scans, clocks, orders of quaternions, mounts, sweeps that are compensated for motion or
not: each is tried on a few scans, and all are judged by the same measures (``judge``). Readers,
the quick check and the doctor use them.
"""
