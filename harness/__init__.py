"""What tests and benchmarks share: judges that hold runs against the simulated world, and what is judged by them."""
