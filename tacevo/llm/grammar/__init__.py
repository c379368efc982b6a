"""The embedded provider: a typed grammar of architectures that answers requests with source text."""
