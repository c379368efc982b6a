"""What the text of a candidate may say."""
