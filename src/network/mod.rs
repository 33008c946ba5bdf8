//! The networks in Burn: operations, blocks, models, weight files.
