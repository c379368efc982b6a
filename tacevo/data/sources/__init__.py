"""The sources of images and labels: directories, tables, arrays, the TacVerse release."""
