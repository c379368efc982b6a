"""Where images and labels come from: folders, tables, arrays, the TacVerse release."""
