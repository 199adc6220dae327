"""Settings that hold for every test."""

import hypothesis

# A shared machine is slow now and then, and the first message of a type loads its type support.
hypothesis.settings.register_profile("impact_rs", deadline=None)
hypothesis.settings.load_profile("impact_rs")
