"""Speed and memory, each figure beside a peer's in the same run; see benchmarks/README.md."""
