"""The router: passes messages on between a learner and actors that cannot reach it."""
