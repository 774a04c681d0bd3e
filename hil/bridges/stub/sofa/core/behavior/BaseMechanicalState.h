// A stand-in for SOFA's BaseMechanicalState and its links: what the bridges call.
#pragma once

#include <sofa/component/haptics/ForceFeedback.h>

namespace sofa::core::behavior {

class BaseMechanicalState : public virtual objectmodel::BaseObject {
public:
    virtual SReal getPX(unsigned int) const { return 0; }
    virtual SReal getPY(unsigned int) const { return 0; }
    virtual SReal getPZ(unsigned int) const { return 0; }
    virtual void applyTranslation(const SReal dx, const SReal dy, const SReal dz) = 0;
};

} // namespace sofa::core::behavior

namespace sofa::core::objectmodel {

struct BaseLink {
    enum { FLAG_STOREPATH = 1, FLAG_STRONGLINK = 2 };
    struct InitLink {
        const char *name, *help;
    };
};

template <class Owner, class Target, unsigned flags> class SingleLink : public BaseLink {
public:
    explicit SingleLink(const InitLink &) {}
    void set(Target *target) { target_ = target; }
    Target *get() const { return target_; }

private:
    Target *target_ = nullptr;
};

} // namespace sofa::core::objectmodel
