//! A folder of posed photographs to views.
