"""A network taken away: trained again, and written as a directory that needs no tacevo."""
