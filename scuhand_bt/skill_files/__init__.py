"""A lab's skills: their files imported, and their mistakes found before a run, by import, signature and `ast`."""
