"""The study's statistics beside those of rliable, the package of Agarwal et al. 2021, in an environment of its own.

make check-statistics
"""
