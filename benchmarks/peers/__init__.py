"""Other people's engines and learners, in an environment of their own (`build/peers/.venv`), beside this project's."""
