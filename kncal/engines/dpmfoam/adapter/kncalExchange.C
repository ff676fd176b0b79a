// kncalExchange: OpenFOAM function object (v1912) that holds a stock DPMFoam between two time steps, publishes the
// gas and the parcel velocities of the finished step, and puts the parcels of an external particle solver in place.
//
// Copyright (C) the kncal authors. Licence: GPL-3.0-or-later, as OpenFOAM, whose templates are compiled in.
//
// Data travel through one shared mapping, 4-byte commands and answers through a socket. Both are inherited as open
// descriptors, named in the environment variable KNCAL_EXCHANGE ("<socket> <memory>"): nothing to open, no names
// left behind. The layout of the mapping is that of kncal/coupling/memory.py; both sides check version and sizes.
// Serial runs only.
//
//     exchange { type kncalExchange; libs ("libkncalExchange.so"); }

#include "functionObject.H"
#include "addToRunTimeSelectionTable.H"
#include "fvMesh.H"
#include "volFields.H"
#include "surfaceFields.H"
#include "OFstream.H"
#include "IStringStream.H"
#include "OSspecific.H"
#include "basicKinematicCollidingCloud.H"

#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <poll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

namespace Foam
{
namespace functionObjects
{

class kncalExchange
:
    public functionObject
{
    enum Command { END = 0, STEP = 1, SAVE = 2 };

    struct Header
    {
        int version;
        int nParcels;        // in: parcels of the coming step; out: parcels after it
        int nMax;            // room for parcels
        int nCells;
        int nInlet;          // faces of the inlet patch
        int padding;
        double inlet;        // inlet velocity of the coming steps [m/s]; NaN: as the case says
        double cpu;          // out: CPU time that this library has taken so far [s]
        double spare[3];
    };
    static_assert(sizeof(Header) == 64, "layout of the mapping");

    static const int version_ = 1;

    const Time& time_;
    const fvMesh& mesh_;
    const label inletPatch_;
    const pid_t parent_;
    int socket_;
    Header* header_;
    double inletSet_;

    // Blocks of the mapping, in this order behind the header
    double *x_, *v_, *d_, *rho_, *weight_, *vNew_;                       // per parcel
    double *gasU_, *gasAlpha_, *gasP_, *UTrans_, *UCoeff_;               // per cell
    double *pInlet_;                                                     // per face of the inlet
    int *cell_;                                                          // per parcel

    // Registered under a name that several base types share: look up the plain base, then cast
    basicKinematicCollidingCloud& parcels() const
    {
        return dynamic_cast<basicKinematicCollidingCloud&>(mesh_.lookupObjectRef<cloud>("kinematicCloud"));
    }

    static void put(double* to, const label i, const vector& a)
    {
        to[3*i] = a.x();
        to[3*i + 1] = a.y();
        to[3*i + 2] = a.z();
    }

    static vector get(const double* from, const label i)
    {
        return vector(from[3*i], from[3*i + 1], from[3*i + 2]);
    }

    void publish() const
    {
        const basicKinematicCollidingCloud& cloud = parcels();
        const volVectorField& U = mesh_.lookupObject<volVectorField>("U.air");
        const volScalarField& alpha = mesh_.lookupObject<volScalarField>("alpha.air");
        const volScalarField& p = mesh_.lookupObject<volScalarField>("p");

        header_->nParcels = cloud.size();
        for (const auto& parcel : cloud)
        {
            put(vNew_, parcel.origId(), parcel.U());
        }
        forAll(U, i)
        {
            put(gasU_, i, U[i]);
            gasAlpha_[i] = alpha[i];
            gasP_[i] = p[i];
            put(UTrans_, i, cloud.UTrans()[i]);
            UCoeff_[i] = cloud.UCoeff()[i];
        }
        const scalarField& pInlet = p.boundaryField()[inletPatch_];
        forAll(pInlet, i)
        {
            pInlet_[i] = pInlet[i];
        }
    }

    void answer() const
    {
        const int token = 1;
        if (::send(socket_, &token, sizeof token, MSG_NOSIGNAL) != sizeof token) orphaned();
    }

    void orphaned() const
    {
        FatalErrorInFunction << "the particle side has gone" << exit(FatalError);
    }

    // The next command. As long as the peer lives a DEM interval may take any time, so every second it is looked
    // whether it does: a socket that some other child of the peer inherited would not tell.
    int receive() const
    {
        struct pollfd waiting = {socket_, POLLIN, 0};
        int ready;
        while ((ready = ::poll(&waiting, 1, 1000)) <= 0)
        {
            if ((ready < 0 && errno != EINTR) || ::getppid() != parent_) orphaned();
        }
        int command = END;
        if (::recv(socket_, &command, sizeof command, MSG_WAITALL) != sizeof command) orphaned();
        return command;
    }

    // The state that a new start of the solver needs, in <case>/state
    void save() const
    {
        const fileName folder(time_.path()/"state");
        mkDir(folder);
        writeField(folder, mesh_.lookupObject<volVectorField>("U.air"));
        writeField(folder, mesh_.lookupObject<volScalarField>("p"));
        writeField(folder, mesh_.lookupObject<surfaceScalarField>("phi.air"));
    }

    template<class Field>
    static void writeField(const fileName& folder, const Field& field)
    {
        OFstream os(folder/field.name(), IOstream::BINARY);
        field.writeHeader(os);
        field.writeData(os);
        IOobject::writeEndDivider(os);
        os.flush();
        if (!os.good())
        {
            FatalErrorInFunction << "cannot write " << os.name() << exit(FatalError);
        }
    }

    // The condition's own velocity is private to it: take a new condition of the same type in its place
    void setInlet(const double velocity)
    {
        volVectorField& U = mesh_.lookupObjectRef<volVectorField>("U.air");
        fvPatchVectorField& now = U.boundaryFieldRef()[inletPatch_];
        char value[64];
        std::snprintf(value, sizeof value, "uniform (0 0 %.17g);", velocity);
        if (now.type() == "fixedValue")
        {
            now == vector(0, 0, velocity);
        }
        else if (now.type() == "interstitialInletVelocity")
        {
            IStringStream text
            (
                "type interstitialInletVelocity; phi phi.air; alpha alpha.air; inletVelocity "
              + string(value) + " value " + string(value)
            );
            const vectorField before(now);
            U.boundaryFieldRef().set
            (
                inletPatch_,
                fvPatchVectorField::New(mesh_.boundary()[inletPatch_], U.internalField(), dictionary(text)).ptr()
            );
            U.boundaryFieldRef()[inletPatch_] == before;      // until the step evaluates it
        }
        else
        {
            FatalErrorInFunction << "no way to change the velocity of a patch of type " << now.type()
                << exit(FatalError);
        }
        inletSet_ = velocity;
    }

    void replace()
    {
        basicKinematicCollidingCloud& cloud = parcels();
        typedef basicKinematicCollidingCloud::parcelType Parcel;
        const label n = header_->nParcels;

        if (n < 0 || n > header_->nMax)
        {
            FatalErrorInFunction << "bad number of parcels " << n << exit(FatalError);
        }
        if (cloud.size() != n)
        {
            cloud.clear();
            for (label i = 0; i < n; ++i)
            {
                Parcel* parcel = new Parcel(mesh_, get(x_, i), cell_[i]);
                parcel->origProc() = 0;
                parcel->origId() = i;
                parcel->active(true);
                parcel->typeId() = 1;
                cloud.addParticle(parcel);
            }
        }
        for (Parcel& parcel : cloud)
        {
            const label i = parcel.origId();
            parcel.relocate(get(x_, i), cell_[i]);
            parcel.U() = get(v_, i);
            parcel.d() = d_[i];
            parcel.rho() = rho_[i];
            parcel.nParticle() = weight_[i];
        }
        if (std::isfinite(header_->inlet) && header_->inlet != inletSet_) setInlet(header_->inlet);

        // What the coming step uses as alpha's old time level, exactly as at a start of the solver
        const scalar alphaMin =
            1.0 - cloud.particleProperties().subDict("constantProperties").get<scalar>("alphaMax");
        volScalarField& alpha = mesh_.lookupObjectRef<volScalarField>("alpha.air");
        alpha = max(1.0 - cloud.theta(), alphaMin);
        alpha.correctBoundaryConditions();
    }

    static double clock()
    {
        struct timespec now;
        ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
        return now.tv_sec + 1e-9*now.tv_nsec;
    }

    // Publish a finished step, and serve until the next one is due or the end is asked for; told is what that cost
    void exchange(const bool finished)
    {
        const double begin = clock();
        if (finished) publish();
        serve();
        header_->cpu += clock() - begin;
    }

    void serve()
    {
        for (;;)
        {
            answer();
            switch (receive())
            {
                case STEP:
                    replace();
                    return;
                case SAVE:
                    save();
                    break;
                case END:
                {
                    // stopAt() sets the end time to infinity, so the end time must be set after it
                    Time& t = const_cast<Time&>(time_);
                    t.stopAt(Time::saNoWriteNow);
                    t.setEndTime(t.value());
                    return;
                }
                default:
                    FatalErrorInFunction << "unknown command" << exit(FatalError);
            }
        }
    }

    void attach()
    {
        int memory = -1;
        struct stat info;
        const char* descriptors = std::getenv("KNCAL_EXCHANGE");
        if
        (
            !descriptors
         || std::sscanf(descriptors, "%d %d", &socket_, &memory) != 2
         || ::fstat(memory, &info) != 0
        )
        {
            FatalErrorInFunction << "KNCAL_EXCHANGE missing or wrong: this case was not started by kncal"
                << exit(FatalError);
        }
        void* base = MAP_FAILED;
        if (info.st_size >= off_t(sizeof(Header)))
        {
            base = ::mmap(nullptr, info.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, memory, 0);
        }
        if (base == MAP_FAILED)
        {
            FatalErrorInFunction << "cannot map the shared memory" << exit(FatalError);
        }
        ::close(memory);
        header_ = static_cast<Header*>(base);

        const off_t m = header_->nMax, c = mesh_.nCells(), f = mesh_.boundary()[inletPatch_].size();
        double* next = reinterpret_cast<double*>(static_cast<char*>(base) + sizeof(Header));
        x_ = next;          next += 3*m;
        v_ = next;          next += 3*m;
        d_ = next;          next += m;
        rho_ = next;        next += m;
        weight_ = next;     next += m;
        vNew_ = next;       next += 3*m;
        gasU_ = next;       next += 3*c;
        gasAlpha_ = next;   next += c;
        gasP_ = next;       next += c;
        UTrans_ = next;     next += 3*c;
        UCoeff_ = next;     next += c;
        pInlet_ = next;     next += f;
        cell_ = reinterpret_cast<int*>(next);
        const off_t size = reinterpret_cast<char*>(cell_ + m) - static_cast<char*>(base);
        if
        (
            header_->version != version_
         || header_->nCells != c
         || header_->nInlet != f
         || info.st_size != size
        )
        {
            FatalErrorInFunction
                << "the two sides disagree: version " << header_->version << " against " << version_
                << ", cells " << header_->nCells << " against " << label(c)
                << ", inlet faces " << header_->nInlet << " against " << label(f)
                << ", bytes " << label(info.st_size) << " against " << label(size)
                << exit(FatalError);
        }
    }

public:

    TypeName("kncalExchange");

    // Constructed at the top of the first step
    kncalExchange(const word& name, const Time& t, const dictionary&)
    :
        functionObject(name),
        time_(t),
        mesh_(t.lookupObject<fvMesh>(polyMesh::defaultRegion)),
        inletPatch_(mesh_.boundaryMesh().findPatchID("inlet")),
        parent_(::getppid()),
        socket_(-1),
        header_(nullptr),
        inletSet_(GREAT)
    {
        // The caller turns errors into warnings and would run on alone without end
        FatalError.dontThrowExceptions();
        if (inletPatch_ < 0)
        {
            FatalErrorInFunction << "the mesh has no patch inlet" << exit(FatalError);
        }
        attach();
        // The case asks for one step only, so that a run without this library (a mere warning) ends at once
        const_cast<Time&>(time_).setEndTime(GREAT);
        exchange(false);
    }

    virtual bool read(const dictionary&) { return true; }

    // At the top of every further step
    virtual bool execute()
    {
        exchange(true);
        return true;
    }

    virtual bool write() { return true; }
};

defineTypeNameAndDebug(kncalExchange, 0);
addToRunTimeSelectionTable(functionObject, kncalExchange, dictionary);

} // End namespace functionObjects
} // End namespace Foam
