//! The list of laws, and the code generated from each of its lines.

/// Generates [`super::Material`], [`super::LAWS`] and all other code that depends on the list, from lines
/// `"name in scenes" => Type`. Each type implements [`super::Law`] and [`super::parameters::BuiltIn`].
macro_rules! laws {
    ($($(#[$doc:meta])* $name:literal => $law:ident),* $(,)?) => {
        $crate::fem::material::list::laws! { @with ($) $($(#[$doc])* $name => $law),* }
    };
    (@with ($d:tt) $($(#[$doc:meta])* $name:literal => $law:ident),*) => {
        /// A hyperelastic law with its parameters.
        #[derive(Debug, Clone, PartialEq)]
        pub enum Material {
            $($(#[$doc])* $law($law),)*
            /// A user-defined law.
            Own(OwnLaw),
        }

        /// Names of all laws in the scene file.
        pub const LAWS: &[&str] = &[$($name),*];

        /// Evaluates an expression with the law inside a [`Material`]; compiled once for each law, and once
        /// for all user-defined laws.
        macro_rules! with_law {
            ($d material:expr, $d law:ident => $d work:expr) => {
                match $d material {
                    $($crate::fem::material::Material::$law($d law) => $d work,)*
                    $crate::fem::material::Material::Own(own) => {
                        let $d law = own.law.as_ref();
                        $d work
                    }
                }
            };
        }
        pub(crate) use with_law;

        impl Material {
            /// Name of the law, as in the scene file.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$law(_) => $name,)*
                    Self::Own(own) => own.name,
                }
            }

            /// The law of [`LAWS`] called `name`, with parameters named by the keys of the scene file.
            pub fn from_parameters(name: &str, given: &[(&str, Value)]) -> Result<Self, ParameterError> {
                match name {
                    $($name => {
                        let given = parameters::Parameters::of::<$law>(name, given);
                        parameters::BuiltIn::from_parameters(&given).map(Self::$law)
                    })*
                    _ => Err(ParameterError::of_law(
                        format!("unknown law \"{name}\""),
                        format!("choose one of {}", LAWS.join(", ")),
                    )),
                }
            }

            /// Warnings about unusual but solvable parameters.
            pub(crate) fn warnings(&self) -> Vec<String> {
                match self {
                    $(Self::$law(law) => parameters::BuiltIn::warnings(law),)*
                    Self::Own(_) => Vec::new(),
                }
            }

            /// Moduli at small strain. `None` if there is no isotropic law with these moduli, or if they are
            /// not known.
            pub(crate) fn small_strain(&self, bulk_modulus_pa: Option<f64>) -> Option<SmallStrain> {
                match self {
                    $(Self::$law(law) => parameters::BuiltIn::small_strain(law, bulk_modulus_pa),)*
                    Self::Own(_) => None,
                }
            }

            /// The law called `name` with these moduli at small strain.
            pub(crate) fn with_small_strain(name: &str, moduli: &SmallStrain) -> Option<Self> {
                match name {
                    $($name => parameters::BuiltIn::with_small_strain(moduli).map(Self::$law),)*
                    _ => None,
                }
            }

            /// The law whose energy is the derivative of this one's with respect to a number of the scene,
            /// the other numbers of the scene held. `None` if the law has no such number or its energy is not
            /// linear in it.
            pub(crate) fn derivative(&self, key: &str) -> Option<Self> {
                match self {
                    $(Self::$law(law) => parameters::BuiltIn::derivative(law, key).map(Self::$law),)*
                    Self::Own(_) => None,
                }
            }

            /// The parameters of all laws, without duplicates.
            pub(crate) fn keys() -> Vec<Key> {
                let mut keys: Vec<Key> = Vec::new();
                for key in [$(<$law as parameters::BuiltIn>::KEYS),*].concat() {
                    if !keys.contains(&key) {
                        keys.push(key);
                    }
                }
                keys
            }
        }

        $(impl From<$law> for Material {
            fn from(law: $law) -> Self {
                Self::$law(law)
            }
        })*
    };
}

pub(super) use laws;
