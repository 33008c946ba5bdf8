//! From restored images and ground truth to tables.
