"""No test fails because the machine was busy: examples have no deadline."""

from hypothesis import settings

settings.register_profile("cyclekit", deadline=None, print_blob=True)
settings.load_profile("cyclekit")
