"""Where images and labels come from: directories, tables, arrays, the TacVerse release."""
