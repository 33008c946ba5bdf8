//! Compares every stage with reference vectors that other software made; `fixtures/README.md` says which.

mod codes;
mod discnet;
mod formation;
mod fusion;
mod metrics;
mod panorama;
mod training;
mod wiener;
