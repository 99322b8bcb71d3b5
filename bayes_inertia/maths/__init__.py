"""Mathematics that knows nothing of campaigns: quaternions, inertia tensors, least squares.

Enters: arrays. Leaves: arrays; nothing here reads files, keeps state or knows a sensor.
`values` makes the dataclasses of all wings, which may hold arrays.
"""
