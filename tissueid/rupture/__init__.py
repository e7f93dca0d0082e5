"""From recordings to failure: what broke the tissue, how sure that is, and what speed has to do with it.

``loading`` (a recording up to its end) -> ``failures`` (measures under the fitted law) -> ``likelihood`` ->
``evidence`` -> ``study`` (everything that is said of a cohort) -> ``document``.
"""
