"""A lab's own tests: workflows by `*.test.yaml` files, skills and workflows in Python by a pytest plugin."""
