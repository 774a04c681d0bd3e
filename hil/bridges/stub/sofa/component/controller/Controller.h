// A stand-in for SOFA's Controller: the events of an animation step.
#pragma once

#include <sofa/core/behavior/BaseMechanicalState.h>

namespace sofa::component::controller {

class Controller : public virtual core::behavior::BaseController {
public:
    void init() override {}
    virtual void onBeginAnimationStep(const double) {}
    virtual void onEndAnimationStep(const double) {}

protected:
    core::objectmodel::BaseLink::InitLink initLink(const char *name, const char *help) { return {name, help}; }
};

} // namespace sofa::component::controller
