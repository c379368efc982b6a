"""The smallest part of each kind, named as the kind: what `tacevo init NAME --part KIND` copies."""
