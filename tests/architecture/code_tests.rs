//! Tests of the reader of Rust: what it takes for code, and where it finds paths to lead.

use super::code::{code_of, named_modules};

/// The code without the spaces that stand for what is left out.
fn squeezed(text: &str) -> String {
    code_of(text).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn comments_and_literals_are_no_code() {
    assert_eq!(squeezed("a(); // crate::b\nc(); /* d /* e */ f */ g();"), "a(); c(); g();");
    assert_eq!(squeezed(r#"say("crate::a \" crate::b"); b"#), "say( ); b");
    assert_eq!(squeezed(r###"say(r#"one " two"#, br"three"); b"###), "say( , b ); b");
    assert_eq!(squeezed("let c = '\"'; let d = '\\''; e::<'a>()"), "let c = ; let d = ; e::<'a>()");
}

#[test]
fn lines_stay_where_they_are() {
    let text = "a\n/* b\nc */\n#[cfg(test)]\nmod tests {\n}\nd";
    assert_eq!(code_of(text).lines().position(|line| line == "d"), Some(6));
}

#[test]
fn what_stands_below_a_test_is_code() {
    assert_eq!(squeezed("#[cfg(test)]\nmod tests { fn a() { b(); } }\nfn c() {}"), "fn c() {}");
    assert_eq!(squeezed("#[cfg(test)]\nuse a::{b, c};\nuse d::e;"), "use d::e;");
    assert_eq!(squeezed("#[cfg(test)]\nmod tests;\nmod c;"), "mod c;");
    assert_eq!(squeezed("#[cfg(test)]\n#[derive(A, B)]\nstruct C { d: [u8; 2] }\nfn e() {}"), "fn e() {}");
    assert_eq!(squeezed("struct A { #[cfg(test)] b: C, d: E }"), "struct A { d: E }");
    assert_eq!(squeezed("{ #[cfg(test)] if a { b(); } c(); }"), "{ c(); }");
}

#[test]
fn every_form_of_a_path_is_followed() {
    let named = |code: &str| named_modules(code, &["synth", "run"]).join(" ");
    assert_eq!(named("use crate::train::Trainer;"), "train");
    assert_eq!(named("use crate::{core::{error::Error, fft}, train, io as files};"), "core train io");
    assert_eq!(named("use crate::{\n    core::fft::{self, Otf},\n    train::*,\n};"), "core train");
    assert_eq!(named("let a = crate::train::start(crate::io::read(b));"), "train io");
    assert_eq!(named("use super::kernels::Kernels;"), "synth");
    assert_eq!(named("use super::super::train::Trainer;"), "train");
    assert_eq!(named("use super::{kernels, super::train::Trainer, scenes};"), "synth train synth");
    assert_eq!(named("use self::parts::A; self.part(); use supper::a;"), "synth");
    assert_eq!(named("pub(crate) fn a() {} pub(in crate::train) fn b() {}"), "train");
}

#[test]
fn modules_within_a_file_count_for_what_they_leave() {
    let named = |code: &str| named_modules(code, &["synth"]).join(" ");
    assert_eq!(named("mod a { use super::super::train; } use super::core;"), "train core");
    assert_eq!(
        named("mod a { mod b { use super::c; } fn d() { { } } } fn e() { super::io::f() }"),
        "synth io"
    );
}
