"""Problems, rivals and records of the comparisons in ``compare_models.py`` and ``compare_criteria.py``."""
