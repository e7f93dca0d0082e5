"""A session in a browser: server, frames, page.  It watches, and leads a simulated hand alone."""
