"""The mathematics: kernels, expansion, networks, objectives and the update. Pure, jitted, no I/O.

Axis letters, everywhere in this package:
    T steps of a rollout      N environments      B = T * N transitions of a batch
    O observation size        A action size       d feature size
    M centres of the expansion                    n transitions drawn for a functional gradient
"""
