"""The scene flow, the benchmark flow, suites, and the command line."""
