"""The dashboard: a process of its own that shows a lab's runs on a page, and speaks to them as the commands do."""
