"""From the posteriors of specimens to the population they were drawn from; no recording is read again."""
