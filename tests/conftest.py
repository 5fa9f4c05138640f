from hypothesis import HealthCheck, settings

settings.register_profile(
    "mexpress",
    derandomize=True,
    deadline=None,
    max_examples=50,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("mexpress")
