"""The two papers this project starts from, recomputed: each number beside the published one."""
