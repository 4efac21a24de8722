"""Pictures, pages and tables for people, and the folder of a run."""
