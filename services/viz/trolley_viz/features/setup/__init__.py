"""The guided setup."""
