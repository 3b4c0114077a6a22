//! The EgoTac network.
