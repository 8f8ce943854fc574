"""What tests of several kinds share: processes, a router, configurations, a bus to talk on."""
