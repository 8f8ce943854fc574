"""What is known of the robots: their streams, frames and past trips."""
