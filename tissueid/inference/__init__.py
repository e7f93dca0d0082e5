"""One engine: logs reduced to blocks, one law, one likelihood, one posterior with the machine inside it."""
