"""The policy: what the text of a candidate may say."""
