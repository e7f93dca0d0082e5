"""Protocols that identify a tissue to a wanted precision in the least machine time.

A protocol is a number of indentations (speed, depth, hold, repeats) recorded with one setting of the load
channel.  On the path that the machine will follow, contact model and noise give the Fisher information of
each; gains and contact points of the logs are eliminated as the fit does it, so that the information of a
protocol is the sum over its logs, and a search needs each indentation once.
"""
