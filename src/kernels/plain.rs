//! Loops of other modules, compiled for the vectors of this CPU.

use super::simd::{Isa, Kernel, Simd};

/// What [`vectorised`] makes of the arguments of a function.
pub(crate) trait Body {
    /// What the function returns.
    type Output;
    /// Runs its body.
    fn run(self) -> Self::Output;
}

/// Runs a body as it is compiled for the instruction set in use.
#[inline]
pub(crate) fn run<B: Body>(body: B) -> B::Output {
    struct Entered<B>(B);

    impl<B: Body> Kernel for Entered<B> {
        type Output = B::Output;

        #[inline(always)]
        fn run<S: Simd>(self, _: S) -> B::Output {
            self.0.run()
        }
    }

    Isa::current().run(Entered(body))
}

/// Defines a function whose body is compiled once for each instruction set, so that its loops become vectors of the set in use:
/// `vectorised! { fn name<'a>(argument: Type, …) -> Output { … } }`.
///
/// What the body calls has to be inlined (`#[inline(always)]`): other functions are compiled for the oldest of CPUs. Nothing is
/// fused: a body that adds up in a fixed number of lanes has the same bits with every set.
macro_rules! vectorised {
    ($(#[$attribute:meta])* fn $name:ident<$($lifetime:lifetime),+>($($argument:ident: $type:ty),* $(,)?) -> $output:ty $body:block) => {
        $(#[$attribute])*
        fn $name<$($lifetime),+>($($argument: $type),*) -> $output {
            struct Arguments<$($lifetime),+>($($type,)* std::marker::PhantomData<($(&$lifetime (),)+)>);

            impl<$($lifetime),+> $crate::kernels::Body for Arguments<$($lifetime),+> {
                type Output = $output;

                #[inline(always)]
                fn run(self) -> $output {
                    let Self($($argument,)* _) = self;
                    $body
                }
            }

            $crate::kernels::run(Arguments($($argument,)* std::marker::PhantomData))
        }
    };
}

pub(crate) use vectorised;

#[cfg(test)]
mod tests {
    vectorised! {
        fn doubled<'a>(numbers: &'a mut [f32], more: f32) -> f32 {
            numbers.iter_mut().for_each(|number| *number = 2.0 * *number + more);
            numbers[1]
        }
    }

    #[test]
    fn a_body_gets_its_arguments_and_returns() {
        let mut numbers = [1.0, 2.5, 3.0];
        assert_eq!((doubled(&mut numbers, 0.5), numbers), (5.5, [2.5, 5.5, 6.5]));
    }
}
