"""Laws, a file each; every one is found by its place in this folder."""
