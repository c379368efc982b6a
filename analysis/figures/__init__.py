"""Pictures of results, one function each: records in, a Matplotlib figure out; nothing is computed but the layout."""
