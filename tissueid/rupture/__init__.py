"""From recordings to failure: what broke the tissue, how sure that is, and what speed has to do with it."""
