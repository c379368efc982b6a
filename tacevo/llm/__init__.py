"""Providers that answer requests with text: hosted models, local servers and the embedded grammar."""
