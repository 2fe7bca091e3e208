"""What several tests share: small worlds, files on disk, plain reference implementations."""
