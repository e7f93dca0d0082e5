"""From the posteriors of specimens to the population they were drawn from.

A hierarchical model in two stages: the stage-1 posterior of every specimen is the proposal of the second, in
which specimens are drawn from a multivariate t distribution around a mean with covariates and random effects.
No recording is read again.
"""
