"""Reading and writing files: recordings, file formats, the folders of runs. Nothing below touches a file."""
