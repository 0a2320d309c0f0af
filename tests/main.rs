//! The one integration-test binary.
#[test] fn t(){}
