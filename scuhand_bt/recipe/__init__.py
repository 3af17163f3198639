"""A recipe: from its text and tables to checked samples, and to the jobs of a plan."""
