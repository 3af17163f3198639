"""A recipe, from its text and tables to the samples and jobs of a plan."""
