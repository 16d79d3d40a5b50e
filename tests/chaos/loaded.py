"""What every process of the chaos tests loads: done once, in the process that the others are forked from.

The wall clock comes first, so that a fault can make it jump.
"""

from tests.chaos.faulty import CLOCK

CLOCK.install()

import reskpn.cli  # noqa: E402
import reskpn.supervision.stopping  # noqa: E402, F401
import services.actor.service  # noqa: E402
import services.learner.service  # noqa: E402, F401
