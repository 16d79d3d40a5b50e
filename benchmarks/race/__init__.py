"""The race: mean training return by wall time on two cores, this project beside its peers.

    python -m benchmarks.race --tasks hopper --seeds 0 1 2 --minutes 3 --entrants default sb3 sbx reference
    python -m benchmarks.race.draw --into docs/study.md

A run is made once and found again by its file, so the command may be stopped and given again.
"""
